/** What the page tells about: errors, the connection, who steers, help. */
import {createElement} from "./elements.js";
import {INPUT_HELP} from "./input.js";

const TOAST_SECONDS = 8;
const MAX_TOASTS = 3;

/** Short messages at the bottom that go by themselves. */
export class Toasts {
  constructor() {
    this.element = createElement("div", {class: "toasts", role: "status", "aria-live": "polite"});
    this.timers = new Set();
  }

  /** @param {string} message @param {?string} key of the scene that it is about */
  show(message, key = null) {
    const same = [...this.element.children].find((each) => each.dataset.message === `${key}: ${message}`);
    same?.remove();
    const close = createElement("button", {type: "button", "aria-label": "Close", onclick: () => toast.remove()}, "×");
    const toast = createElement("div", {class: "toast"}, createElement("span", {}, message), close);
    if (key) toast.prepend(createElement("code", {}, key));
    toast.dataset.message = `${key}: ${message}`;
    this.element.append(toast);
    while (this.element.children.length > MAX_TOASTS) this.element.firstChild.remove();
    const timer = setTimeout(() => { toast.remove(); this.timers.delete(timer); }, TOAST_SECONDS * 1000);
    this.timers.add(timer);
  }

  destroy() {
    this.timers.forEach(clearTimeout);
  }
}

/** One line over the view with buttons, while there is something to say. */
export class Banner {
  /** @param {string} name class of the element */
  constructor(name) {
    this.element = createElement("div", {class: `banner ${name}`, role: "status", hidden: true});
    this.shown = "";
  }

  /** @param {string} text "" hides the banner @param {...[string, () => void]} buttons labels and what they do */
  show(text, ...buttons) {
    const content = JSON.stringify([text, buttons.map(([label]) => label)]);
    if (content === this.shown) return;
    this.shown = content;
    this.element.hidden = !text;
    this.element.replaceChildren(createElement("span", {}, text), ...buttons.map(
      ([label, onclick]) => createElement("button", {type: "button", onclick}, label),
    ));
  }
}

/** Say who steers, and let clients ask, grant and refuse.
 * @type {(banner: Banner, client: number, state: {steering: ?number, asking: number[]},
 *   steer: (action: string, client?: number) => void) => void} */
export function showSteering(banner, client, {steering, asking}, steer) {
  const other = asking.find((number) => number !== client);
  if (steering === client && other !== undefined) {
    banner.show(
      `Client ${other} asks to steer`, ["Let them steer", () => steer("grant", other)],
      ["Refuse", () => steer("refuse", other)],
    );
  } else if (steering === null || steering === client) banner.show("");
  else if (asking.includes(client)) banner.show(`Client ${steering} steers. Asked to steer; waiting for an answer.`);
  else banner.show(`Client ${steering} steers`, ["Ask to steer", () => steer("ask")]);
}

/** Dialog with the table of mouse and keys. @returns {HTMLDialogElement} */
export function createHelp() {
  const rows = INPUT_HELP.map(([what, how]) => createElement(
    "tr", {}, createElement("th", {scope: "row"}, what), createElement("td", {}, how),
  ));
  const close = createElement("button", {type: "submit", class: "primary"}, "Close");
  return createElement(
    "dialog", {class: "help", "aria-label": "Mouse, touch and keys"}, createElement("h2", {}, "Mouse, touch and keys"),
    createElement("table", {}, createElement("tbody", {}, ...rows)), createElement("form", {method: "dialog"}, close),
  );
}
