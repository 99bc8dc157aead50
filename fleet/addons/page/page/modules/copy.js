// Commands for a terminal. The clipboard is there on loopback and over TLS only; elsewhere a text is shown, selected.
import { make, write } from "./dom.js";

export async function copyText(text, button) {
  if (await copied(text)) write(button, "Copied");
  else show(text, "Copy this:");
}

export async function showCommand(text, does) {
  show(text, `${does} ${(await copied(text)) ? "The command is copied; run it in a terminal:" : "Run this in a terminal:"}`);
}

async function copied(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}

function show(text, says) {
  const field = make("input", { value: text, readOnly: true, ariaLabel: "Text to copy" });
  const close = make("button", { type: "button", class: "fleet-button", onclick: () => dialog.close() }, "Close");
  const dialog = make("dialog", { class: "fleet-copy", onclose: () => dialog.remove() }, make("p", {}, says), field, close);
  document.querySelector(".fleet-view").append(dialog);
  dialog.showModal();
  field.select();
}
