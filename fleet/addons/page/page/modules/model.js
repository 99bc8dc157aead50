// Values that change, and messages: what a widget of anywidget is given, as far as it is used here.
export class Model {
  #values;
  #listeners = new Map();
  #send;

  constructor(values, send) {
    this.#values = { ...values };
    this.#send = send;
  }

  get(key) {
    return this.#values[key];
  }

  set(key, value) {
    this.#values[key] = value;
    for (const listener of this.#listeners.get(`change:${key}`) ?? []) listener();
  }

  on(event, listener) {
    if (!this.#listeners.has(event)) this.#listeners.set(event, new Set());
    this.#listeners.get(event).add(listener);
  }

  off(event, listener) {
    this.#listeners.get(event)?.delete(listener);
  }

  send(message) {
    this.#send(message);
  }
}
