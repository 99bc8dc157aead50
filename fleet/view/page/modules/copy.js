// A text for the clipboard, which is there on loopback and over TLS only; elsewhere the text is shown, selected.
import { make, write } from "./dom.js";

export async function copyText(text, button) {
  try {
    await navigator.clipboard.writeText(text);
    write(button, "Copied");
  } catch {
    show(text);
  }
}

function show(text) {
  const field = make("input", { value: text, readOnly: true, ariaLabel: "Text to copy" });
  const close = make("button", { type: "button", class: "fleet-button", onclick: () => dialog.close() }, "Close");
  const dialog = make("dialog", { class: "fleet-copy", onclose: () => dialog.remove() }, make("p", {}, "Copy this:"), field, close);
  document.querySelector(".fleet-view").append(dialog);
  dialog.showModal();
  field.select();
}
