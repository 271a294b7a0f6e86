// Controls of the panels, each bound to one key of the scene.

import {createElement} from "./elements.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */
/**
 * @typedef {object} Field
 * @property {string} key
 * @property {HTMLElement} element
 * @property {(value: any, state: any) => void} show
 * @property {boolean} busy  whether it is dragged, so that states do not move it
 * @property {number} input  number of its last edit
 */

const SVG_NAMESPACE = "http://www.w3.org/2000/svg";
let gestureCount = 0;

/** Create an SVG element.
 * @type {(tag: string, attributes?: Record<string, any>, ...children: (Node | string)[]) => any} */
export function createSvg(tag, attributes = {}, ...children) {
  const element = document.createElementNS(SVG_NAMESPACE, tag);
  changeAttributes(element, attributes);
  element.append(...children);
  return element;
}

/** Set attributes of an element. */
export function changeAttributes(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
}

/** The value at a path with dots, such as "volumes.0.clim"; undefined if there is none. */
export function valueAt(scene, path) {
  return path.split(".").reduce((value, name) => (value == null ? undefined : value[name]), scene);
}

/** A number with at most five significant digits, which a field has room for. */
export function formatNumber(value) {
  if (value == null || !Number.isFinite(value)) return "";
  return String(Number(value.toPrecision(5)));
}

/** The number of a text, with a decimal point or comma; NaN if it is none. */
export function parseNumber(text) {
  const plain = text.trim().replace(",", ".");
  return plain === "" ? NaN : Number(plain);
}

/** "#rrggbb" of [r, g, b] in 0..1. */
export function hexColour(rgb) {
  const byte = (part) => Math.round(255 * Math.min(1, Math.max(0, part)));
  return `#${rgb.map((part) => byte(part).toString(16).padStart(2, "0")).join("")}`;
}

/** [r, g, b] in 0..1 of "#rrggbb". */
export function rgbOfHex(text) {
  return [1, 3, 5].map((at) => Number((parseInt(text.slice(at, at + 2), 16) / 255).toFixed(4)));
}

/** "#rrggbb" of any CSS colour; "#000000" if the browser does not know it. */
export function hexOfCss(name) {
  const context = document.createElement("canvas").getContext("2d");
  context.fillStyle = "#000000";
  context.fillStyle = name;
  return String(context.fillStyle);
}

/** A tag under which all edits of one gesture are one step of the history. */
export function newGesture(key) {
  gestureCount += 1;
  return `${key} ${gestureCount}`;
}

/** What is known of a key: description, choices and range. */
export function keyFacts(viewer, key) {
  return viewer.hello?.keys?.[key.replace(/\.\d+(?=\.|$)/g, ".0")] ?? {};
}

/** Fields of one panel: they show each new state, but not while they are edited. */
export class Form {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    /** @type {Field[]} */
    this.fields = [];
  }

  /**
   * Bind an element to a key.
   * @returns {Field}
   */
  bind(key, element, show) {
    element.dataset.key = key;
    element.title ||= keyFacts(this.viewer, key).description ?? "";
    const field = {key, element, show, busy: false, input: 0};
    this.fields.push(field);
    return field;
  }

  /** Send a field's value; `more` are other keys that change with it. */
  send(field, value, {moving = false, merge = undefined, more = {}} = {}) {
    field.busy = moving;
    field.input = this.viewer.edit({[field.key]: value, ...more}, {moving, merge}) ?? 0;
  }

  /** Show a state in all fields that are not edited and for which it is not older than their last edit. */
  show(state) {
    for (const field of this.fields) {
      const isOld = this.viewer.steers && state.input < field.input;
      if (!field.busy && !isOld) field.show(valueAt(state.scene, field.key), state);
    }
  }

  /** A number in a text field; arrow keys change its last shown digit. */
  number(key, label, options = {}) {
    const input = numberInput((value, gesture) => this.send(field, value, gesture), options);
    const row = labelled(label, input);
    const field = this.bind(key, row, (value) => showText(input, formatNumber(value)));
    return row;
  }

  /**
   * A slider with a number beside it, for a number or for one part of a list of numbers.
   * @param {object} options  the slider's range and limit, which the number may leave
   * @param {number} options.low
   * @param {number} options.high
   * @param {boolean} [options.log]
   * @param {number} [options.part]  index in the list
   * @param {(value: number, list: number[]) => number} [options.limit]
   */
  slider(key, label, options) {
    const slider = sliderInput();
    let whole = [];
    const {part} = options;
    const send = (value, gesture) => this.send(field, part == null ? value : whole.with(part, value), gesture);
    const input = numberInput(send);
    const row = labelled(label, slider, input);
    row.classList.add("with-slider");
    onSlide(slider, key, (gesture) => {
      const slid = slidValue(slider, options);
      const value = options.limit ? options.limit(slid, whole) : slid;
      input.value = formatNumber(value);
      send(value, gesture);
    });
    const field = this.bind(key, row, (found) => {
      whole = found ?? [];
      const value = part == null ? found : whole[part];
      if (value != null) slider.value = String(slidePosition(value, options));
      showText(input, formatNumber(value));
    });
    return row;
  }

  /** One of some names; `choices` are names, or [value, text] pairs. `more(value)` are keys that change with it. */
  select(key, label, choices = keyFacts(this.viewer, key).choices ?? [], more = () => ({})) {
    const pairs = choices.map((choice) => (Array.isArray(choice) ? choice : [choice, String(choice)]));
    const option = ([value, text]) => createElement("option", {value: JSON.stringify(value)}, text);
    const select = createElement("select", {}, ...pairs.map(option));
    select.addEventListener("change", () => {
      const value = JSON.parse(select.value);
      this.send(field, value, {more: more(value)});
    });
    const row = labelled(label, select);
    const field = this.bind(key, row, (value) => showChoice(select, value));
    return row;
  }

  /** A check box; `on` and `off` are the values of its two positions. */
  check(key, label, {on = true, off = false} = {}) {
    const box = createElement("input", {type: "checkbox"});
    box.addEventListener("change", () => this.send(field, box.checked ? on : off));
    const row = createElement("label", {class: "row check"}, box, createElement("span", {}, label));
    const field = this.bind(key, row, (value) => (box.checked = Boolean(value)));
    return row;
  }

  /** A colour [r, g, b] in 0..1. */
  colour(key, label) {
    const input = createElement("input", {type: "color", "aria-label": label});
    let merge = newGesture(key);
    input.addEventListener("input", () => this.send(field, rgbOfHex(input.value), {moving: true, merge}));
    input.addEventListener("change", () => {
      this.send(field, rgbOfHex(input.value), {merge});
      merge = newGesture(key);
    });
    const row = labelled(label, input);
    const field = this.bind(key, row, (value) => {
      if (value != null) input.value = typeof value === "string" ? hexOfCss(value) : hexColour(value);
    });
    return row;
  }

  /** Numbers in one row, such as a position; `titles` name them. */
  vector(key, label, titles) {
    let shown = [];
    const inputs = titles.map((title, at) =>
      numberInput((value, gesture) => this.send(field, shown.with(at, value), gesture), {title}),
    );
    const row = labelled(label, ...inputs);
    row.classList.add("vector");
    const field = this.bind(key, row, (value) => {
      shown = value ?? titles.map(() => 0);
      inputs.forEach((input, at) => showText(input, formatNumber(shown[at])));
    });
    return row;
  }
}

/** A row of a panel: a label and what it names. */
export function labelled(label, ...controls) {
  for (const one of controls) if (one.matches("input, select")) one.ariaLabel ??= one.title || label;
  return createElement("div", {class: "row"}, createElement("span", {class: "label"}, label), ...controls);
}

/** A button. */
export function button(text, onPress, attributes = {}) {
  return createElement("button", {type: "button", onclick: onPress, ...attributes}, text);
}

/**
 * A text field for a number. `commit(value, {moving, merge})` is called after a change.
 * Arrow keys change the value by a hundredth of its magnitude, with shift by a tenth.
 */
export function numberInput(commit, {title = "", empty = false} = {}) {
  const attributes = {type: "text", inputmode: "decimal", class: "number", autocomplete: "off"};
  const input = createElement("input", {...attributes, title});
  const finish = () => {
    input.dataset.typed = "";
    const value = parseNumber(input.value);
    if (empty && input.value.trim() === "") commit(null, {});
    else commit(Number.isNaN(value) ? input.value : value, {});
  };
  input.addEventListener("input", () => (input.dataset.typed = "yes"));
  input.addEventListener("change", finish);
  input.addEventListener("keydown", (event) => {
    const sign = {ArrowUp: 1, ArrowDown: -1}[event.key];
    const value = parseNumber(input.value);
    if (!sign || Number.isNaN(value)) return;
    event.preventDefault();
    input.value = formatNumber(value + sign * stepOf(value) * (event.shiftKey ? 10 : 1));
    commit(parseNumber(input.value), {merge: `${title} ${input.dataset.merge ?? ""}`});
  });
  input.addEventListener("focus", () => {
    input.dataset.merge = newGesture("number");
    input.dataset.before = input.value;
  });
  input.addEventListener("keydown", (event) => {
    if (event.key === "Escape") showText(input, input.dataset.before ?? "", true);
  });
  return input;
}

/** The step of arrow keys: the power of ten of a hundredth of a value. */
function stepOf(value) {
  return value === 0 ? 0.01 : 10 ** Math.floor(Math.log10(Math.abs(value) / 10));
}

/** Show a text unless the user is typing another one. */
export function showText(input, text, always = false) {
  if (!always && input.dataset.typed && document.activeElement === input) return;
  input.dataset.typed = "";
  input.value = text;
}

function showChoice(select, value) {
  const text = JSON.stringify(value ?? null);
  if (![...select.options].some((option) => option.value === text)) {
    select.append(createElement("option", {value: text}, typeof value === "string" ? value : text));
  }
  select.value = text;
}

/** A slider with 1000 positions. */
export function sliderInput() {
  return createElement("input", {type: "range", min: 0, max: 1000, step: 1});
}

/** Call `move({moving, merge})` while a slider is dragged, and once more without `moving` when it is released. */
export function onSlide(slider, key, move) {
  let merge = newGesture(key);
  slider.addEventListener("input", () => move({moving: true, merge}));
  slider.addEventListener("change", () => {
    move({moving: false, merge});
    merge = newGesture(key);
  });
}

/** The value at a slider's position. */
export function slidValue(slider, {low, high, log = false}) {
  const share = Number(slider.value) / 1000;
  const value = log ? low * (high / low) ** share : low + (high - low) * share;
  return Number(value.toPrecision(4));
}

/** The position of a value on a slider, 0 to 1000. */
export function slidePosition(value, {low, high, log = false}) {
  const share = log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(1000 * Math.min(1, Math.max(0, share)));
}
