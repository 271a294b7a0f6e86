// Choice of a colour map: names with previews, a search, and the reverse of each.

import {button, labelled} from "./controls.js";
import {createElement} from "./elements.js";
import {hasColourPoints} from "./transfer_model.js";

/** CSS gradient of colours [[r, g, b], …] at equal distances. */
export function cssGradient(colours) {
  const parts = colours.map((rgb) => `rgb(${rgb.map((part) => Math.round(255 * part)).join(" ")})`);
  return `linear-gradient(to right, ${parts.join(", ")})`;
}

export class ColourMapPicker {
  /**
   * @param {import("./controls.js").Form} form
   * @param {string} key  such as "volumes.0.cmap"
   * @param {(() => void) | null} editColours  turns the map into control points
   */
  constructor(form, key, editColours) {
    this.form = form;
    this.name = "";
    this.preview = createElement("span", {class: "preview"});
    this.title = createElement("span", {class: "map-name"});
    this.search = createElement("input", {type: "search", placeholder: "Search…", title: "Search colour maps"});
    this.list = createElement("div", {class: "map-list"});
    this.opened = createElement("details", {class: "map-choice"});
    this.opened.append(createElement("summary", {}, this.preview, this.title), this.search, this.list);
    this.reverse = createElement("input", {type: "checkbox", title: "Reverse the colours"});
    const points = editColours && button("edit", editColours, {title: "Edit the colours as control points"});
    const reverse = createElement("label", {class: "inline"}, this.reverse, "reverse");
    this.element = labelled("Colours", this.opened, reverse, ...(points ? [points] : []));
    this.element.classList.add("map-row");
    this.points = points;
    this.field = form.bind(key, this.element, (value, state) => this.show(value, state));
    this.listen();
  }

  listen() {
    this.opened.addEventListener("toggle", () => this.opened.open && this.fill());
    this.search.addEventListener("input", () => this.filter());
    this.search.addEventListener("keydown", (event) => {
      event.stopPropagation();
      if (event.key === "Escape") this.opened.open = false;
      if (event.key === "Enter") this.list.querySelector("button:not([hidden])")?.click();
    });
    this.reverse.addEventListener("change", () => this.take(this.name.replace(/_r$/, "")));
  }

  /** Fill the list when it is opened for the first time. */
  fill() {
    this.search.focus();
    if (this.list.children.length) return;
    const maps = this.form.viewer.hello?.colour_maps ?? [];
    this.list.append(...maps.map((map) => this.item(map)));
    this.filter();
  }

  item({name, colours}) {
    const preview = createElement("span", {class: "preview"});
    preview.style.backgroundImage = cssGradient(colours);
    return createElement("button", {type: "button", title: name, onclick: () => this.choose(name)}, preview, name);
  }

  filter() {
    const words = this.search.value.toLowerCase().split(/\s+/);
    for (const item of this.list.children) {
      item.hidden = !words.every((word) => item.title.toLowerCase().includes(word));
    }
  }

  choose(name) {
    this.opened.open = false;
    this.take(name);
  }

  take(name) {
    this.form.send(this.field, this.reverse.checked ? `${name}_r` : name);
  }

  show(value) {
    const isName = typeof value === "string";
    this.name = isName ? value : "";
    this.reverse.checked = isName && value.endsWith("_r");
    this.reverse.disabled = !isName || value.endsWith(".json");
    if (this.points) this.points.hidden = hasColourPoints(value);
    this.title.textContent = isName ? value : value ? "control points" : "";
    this.preview.style.backgroundImage = cssGradient(this.colours(value));
  }

  colours(value) {
    if (Array.isArray(value)) return [value[0], ...value].map((row) => row.slice(-3));
    const maps = this.form.viewer.hello?.colour_maps ?? [];
    const found = maps.find((map) => map.name === this.name.replace(/_r$/, ""))?.colours;
    const shown = found ?? [[0.5, 0.5, 0.5], [0.5, 0.5, 0.5]];
    return this.reverse.checked ? [...shown].reverse() : shown;
  }
}
