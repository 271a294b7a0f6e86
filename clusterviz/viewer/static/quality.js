// Panel of the quality: each setting, with its measured time and error.

import {Form, button, formatNumber} from "./controls.js";
import {createElement} from "./elements.js";

/** Keys whose values are chosen where there is an error bound. */
const CHOSEN_BY_BOUND = new Set(
  ["step", "classification", "filter", "early_termination", "adaptive", "pixel"].map((name) => `quality.${name}`),
);
const QUALITY_ROWS = [
  (form) => form.slider("quality.step", "Step", {low: 0.1, high: 8, log: true}),
  (form) => form.select("quality.classification", "Classification"),
  (form) => form.slider("quality.early_termination", "Early termination", {low: 0, high: 0.05}),
  (form) => form.slider("quality.adaptive", "Adaptive step", {low: 0, high: 0.05}),
  (form) => form.select("quality.filter", "Filter"),
  (form) => form.number("quality.max_error", "Largest error", {empty: true}),
  (form) => form.select("quality.pixel", "Pixel format"),
  (form) => form.select("quality.renderer", "Renderer"),
  (form) => form.check("quality.jitter", "Jitter"),
  (form) => form.check("quality.frame_coherence", "Frame coherence"),
];

/** Seconds as "1.2 s" or "35 ms". */
export function formatSeconds(seconds) {
  if (seconds == null) return "–";
  return seconds >= 0.9995 ? `${seconds.toPrecision(3)} s` : `${Number((1000 * seconds).toPrecision(3))} ms`;
}

/** An error of a full scale of 1 as a share of 1/255. */
export function formatError(error) {
  if (error == null) return "–";
  return error === 0 ? "0" : `${Number((255 * error).toPrecision(2))}/255`;
}

export class QualityPanel {
  constructor(viewer) {
    this.viewer = viewer;
    this.measured = new Map();
    this.budget = createElement("div", {class: "note"});
    this.element = createElement("div");
    viewer.on("knobs", (message) => this.showMeasured(message.items));
  }

  show(state) {
    if (!this.form) this.buildRows();
    this.form.show(state);
    const budget = this.viewer.hello?.budget_ms;
    this.budget.textContent = budget ? `While moving: ${formatNumber(budget)} ms a picture; size and step adapt.` : "";
    this.showAccuracy(state);
  }

  buildRows() {
    this.form = new Form(this.viewer);
    for (const make of QUALITY_ROWS) {
      const row = make(this.form);
      const choices = createElement("div", {class: "measured"});
      this.measured.set(row.dataset.key, choices);
      this.element.append(row, choices);
    }
    this.element.append(this.budget);
  }

  /** With an error bound, the settings that it chooses have no effect. */
  showAccuracy(state) {
    const isBound = state.scene.quality.max_error != null;
    for (const row of this.element.querySelectorAll("[data-key]")) {
      row.classList.toggle("unused", isBound && CHOSEN_BY_BOUND.has(row.dataset.key));
    }
  }

  /** Show the choices of each key, with the time and error that were measured for them. */
  showMeasured(items) {
    if (!this.form) this.buildRows();
    for (const [key, place] of this.measured) {
      const item = items.find((one) => one.key === key);
      place.replaceChildren(...(item ? [this.table(item)] : []));
    }
  }

  table({key, value, choices}) {
    const slowest = Math.max(...choices.map((choice) => choice.seconds ?? 0)) || 1;
    const rows = choices.map((choice) => this.choice(key, choice, value, slowest));
    return createElement("div", {class: "choices"}, ...rows);
  }

  choice(key, {value, seconds, error}, present, slowest) {
    const bar = createElement("span", {class: "cost"});
    bar.style.width = `${(100 * (seconds ?? 0)) / slowest}%`;
    const take = () => this.viewer.edit({[key]: value}, {moving: false});
    const isPresent = JSON.stringify(value) === JSON.stringify(present);
    const attributes = {"aria-pressed": String(isPresent), title: `Set ${key} to this value`};
    const texts = [choiceText(value), formatSeconds(seconds), formatError(error)];
    const row = button("", take, attributes);
    row.append(bar, ...texts.map((text) => createElement("span", {}, text)));
    return row;
  }
}

function choiceText(value) {
  if (typeof value === "number") return formatNumber(value);
  return typeof value === "string" ? value : value == null ? "off" : JSON.stringify(value);
}
