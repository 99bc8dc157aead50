// Elements in one call.
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (name in element && name !== "list") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

// Change a text only where it differs: what stays as it is costs nothing, and keeps its selection.
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export const number = (value, digits, unit) => (value == null ? "-" : `${value.toFixed(digits)} ${unit}`);

// How old the newest is that was heard; null: it was sent before all that the page knows.
export const old = (age, since) => (age == null ? `sent before ${since.toFixed(1)} s` : `${age.toFixed(1)} s old`);

// A canvas with as many dots as its size on the screen has: its context, in pixels of the page, and its size in these.
export function fitted(canvas) {
  const dots = Math.min(2, window.devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * dots);
  canvas.height = Math.round(height * dots);
  const g = canvas.getContext("2d");
  g.setTransform(dots, 0, 0, dots, 0, 0);
  return { g, width, height };
}
