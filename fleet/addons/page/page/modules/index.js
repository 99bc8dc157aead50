// A run in one page: the fleet, charts and numbers. `render` gets a model and an element, and knows no toolkit.
import { Bar } from "./bar.js";
import { Charts } from "./charts.js";
import { useTheme } from "./colours.js";
import { make } from "./dom.js";
import { legend } from "./legend.js";
import { Panels } from "./panels.js";
import { Scene } from "./scene.js";

export { Model } from "./model.js";

const SEEN_EVERY = 10; // pictures between two words that they have come

export function render({ model, el }) {
  const setup = model.get("setup");
  useTheme(setup);
  const say = (message) => model.send(message);
  const top = make("header", { class: "fleet-bar" });
  const stage = make("div", { class: "fleet-stage" });
  const side = make("aside", { class: "fleet-side" });
  const charts = make("div", { class: "fleet-charts" });
  el.append(top, make("div", { class: "fleet-main" }, stage, charts), side);

  const choose = (i) => {
    scene.chosen = bar.chosen = panels.choose(i || panels.chosen);
    scene.dirty = true;
    say({ do: "commands", i: panels.chosen });
    if (model.get("frame")) panels.frame(model.get("frame"));
  };
  // Where the last click was, as shares of the window: a dialog keeps away from it.
  let at = null;
  const clicked = ({ clientX, clientY }) => (at = [clientX / window.innerWidth, clientY / window.innerHeight, window.innerWidth <= 900]);
  el.addEventListener("pointerdown", clicked, true);
  el.addEventListener("keydown", () => (at = null), true);
  const inject = (i) => setup.may_act && say({ do: "vehicle", i, at });
  const seek = (at_s) => say({ do: "seek", at_s });
  const link = (src, dst) => {
    if (setup.may_act) say({ do: "link", src, dst, at });
  };
  const panels = new Panels(side, setup, {
    onVehicle: choose,
    onLink: link,
    onPoint: (k) => {
      scene.over = k == null ? null : { link: k };
      scene.dirty = true;
    },
    onTime: seek,
    onColumns: (names) => say({ do: "columns", names }),
    onHeal: (id) => say({ do: "heal", id }),
    onInject: inject,
    latest: (name, i) => charting.latest(name, i),
  });
  const scene = new Scene(stage, setup, {
    onLink: link,
    onVehicle: (i) => {
      if (i !== panels.chosen) choose(i);
      if (i) inject(i);
    },
    onLine: (groups) => groups.every((group) => group.length) && say({ do: "partition", groups, at }),
  });
  stage.append(legend(setup));
  const view = () => {
    scene.camera.fromAbove(!scene.camera.above);
    bar.view.textContent = scene.camera.above ? "In 3D" : "From above";
    scene.dirty = true;
  };
  scene.onView = view;
  const act = (message) => say(message.do === "fleet" ? { ...message, at } : message);
  const bar = new Bar(top, setup, act, {
    onView: view,
    onLine: () => {
      scene.drawing = !scene.drawing;
      scene.canvas.style.cursor = scene.drawing ? "crosshair" : "grab";
      scene.canvas.focus();
    },
  });
  const charting = new Charts(charts, setup, { onNames: (names) => say({ do: "charts", names }), onSeek: seek });

  let told = 0;
  const listeners = {
    "change:frame": () => {
      const frame = model.get("frame");
      scene.frame(frame);
      charting.frame(frame);
      panels.frame(frame);
      bar.frame(frame);
      if (frame.n - told < SEEN_EVERY) return;
      told = frame.n;
      say({ do: "seen", n: frame.n });
    },
    "change:history": () => {
      scene.history(model.get("history"));
      charting.history(model.get("history"));
    },
    "change:whole": () => charting.setWhole(model.get("whole")),
    "change:known": () => {
      for (const part of [charting, panels.faults, bar]) part.known(model.get("known"));
    },
    "change:checks": () => {
      panels.checks.write(model.get("checks"));
      for (const part of [charting, bar]) part.checks(model.get("checks"));
    },
    "change:commands": () => panels.writeCommands(model.get("commands")),
    "change:problem": () => bar.problem(model.get("problem")),
    "change:signals": () => {
      charting.offer(model.get("signals"));
      panels.offer(model.get("signals"));
    },
  };
  for (const [event, listener] of Object.entries(listeners)) model.on(event, listener);
  // Space holds and goes on, where it does nothing else: not in fields and on buttons.
  const hold = (event) => {
    const free = event.target === document.body || event.target === scene.canvas;
    if (event.key !== " " || event.repeat || !free || !bar.pause || bar.pause.disabled) return;
    event.preventDefault();
    bar.pause.click();
  };
  document.addEventListener("keydown", hold);
  el.fleet = { scene, charting, live: setup.live }; // for tests, and for who looks with the tools of the browser
  say({ do: "ready" });
  return () => {
    for (const [event, listener] of Object.entries(listeners)) model.off(event, listener);
    document.removeEventListener("keydown", hold);
    scene.end();
    charting.end();
  };
}
