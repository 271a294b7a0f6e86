// Editor of a transfer function: colour, opacity, isovalues and colour limits over the histogram.

import {Form, createSvg, button, formatNumber, hexColour, labelled, maySteer, newGesture, numberInput} from "./controls.js";
import {createElement} from "./elements.js";
import {rgbOfHex, changeAttributes, showText, valueAt} from "./controls.js";
import {PLOT, PlotAxes, histogramPath} from "./histogram.js";
import {ColourMapPicker} from "./colours.js";

/**
 * A handle of the plot: a control point of opacity ("point") or colour ("colour"), an isovalue ("surface"), or an end of
 * the colour limits ("limit").
 * @typedef {{kind: "point"|"surface"|"limit"|"colour", index: number}} Handle
 */

const OPACITY_PRESETS = ["linear", "linear_r", "geom", "geom_r", "sigmoid", "sigmoid_r", "foreground"];
/** Parts of the curve between two points where the opacity axis is not linear. */
const CURVE_PARTS = 16;
const HANDLE_NAMES = {point: "Point", surface: "Isovalue", limit: "Colour limit", colour: "Colour point"};
const HANDLE_KEYS = {point: "opacity", surface: "isosurfaces", limit: "clim", colour: "cmap"};

/** Entry of `state.volumes`, `state.geometry` or `state.grids` for the section at a path such as "volumes.0". */
export function contentEntry(state, path) {
  const each = [...(state.volumes ?? []), ...(state.geometry ?? []), ...(state.grids ?? [])];
  return each.find((entry) => entry.key === path) ?? {};
}

/** Put a row into a list of control points, after those of the same value; return its index. */
export function insertByValue(points, row) {
  const after = points.findIndex((point) => point[0] > row[0]);
  const index = after < 0 ? points.length : after;
  points.splice(index, 0, row);
  return index;
}

/** A value between those of its neighbours, so that control points stay in order; equal ones are a step. */
export function betweenNeighbours(points, index, value) {
  const low = points[index - 1]?.[0] ?? -Infinity;
  const high = points[index + 1]?.[0] ?? Infinity;
  return Math.min(high, Math.max(low, value));
}

/** Opacity at a value of control points; null without points. */
export function opacityAt(points, value) {
  if (!points.length) return null;
  const right = points.findIndex((point) => point[0] > value);
  if (right === 0) return points[0][1];
  if (right < 0) return points[points.length - 1][1];
  const [[x0, y0], [x1, y1]] = [points[right - 1], points[right]];
  return y0 + ((value - x0) / (x1 - x0)) * (y1 - y0);
}

export class TransferEditor {
  /**
   * @param {import("./viewer.js").Viewer} viewer
   * @param {string} path  the section, such as "volumes.0"
   */
  constructor(viewer, path) {
    this.viewer = viewer;
    this.path = path;
    this.form = new Form(viewer);
    this.axis = new PlotAxes(0, 1);
    /** @type {Handle | null} */
    this.selected = null;
    this.points = [];
    this.surfaces = null;
    this.limits = null;
    this.colours = null;
    this.stops = [];
    this.element = createElement("div", {class: "transfer"});
    this.buildPlot();
    this.buildRows();
  }

  buildPlot() {
    const id = `transfer-${Math.random().toString(36).slice(2)}`;
    this.gradient = createSvg("linearGradient", {id, gradientUnits: "userSpaceOnUse"});
    const {left, right, top, bottom, bar, barBottom} = PLOT;
    const size = {x: left, width: right - left};
    this.histogram = createSvg("path", {class: "histogram"});
    this.area = createSvg("path", {class: "area", fill: `url(#${id})`});
    this.curve = createSvg("path", {class: "curve"});
    this.ticks = createSvg("g", {class: "ticks"});
    this.handles = createSvg("g");
    this.clip = createSvg("clipPath", {id: `${id}-clip`}, createSvg("rect", {...size, y: 0, height: bottom + 1}));
    this.svg = createSvg(
      "svg",
      {viewBox: `0 0 ${PLOT.width} ${PLOT.height}`, class: "plot", tabindex: 0, role: "group"},
      createSvg("defs", {}, this.gradient, this.clip),
      createSvg("rect", {...size, y: top, height: bottom - top, class: "plot-background"}),
      createSvg("g", {"clip-path": `url(#${id}-clip)`}, this.histogram, this.area, this.curve),
      createSvg("rect", {...size, y: bar, height: barBottom - bar, fill: `url(#${id})`, class: "colour-bar"}),
      this.ticks,
      this.handles,
    );
    this.svg.setAttribute("aria-label", "Transfer function: double click adds a point, + and - zoom, 0 shows all values");
    this.wrapper = createElement("div", {class: "plot-frame"}, this.svg);
    this.listen();
  }

  listen() {
    const on = (name, react, options) => this.svg.addEventListener(name, react, options);
    on("pointerdown", (event) => this.grab(event));
    on("pointermove", (event) => this.drag(event));
    on("pointerup", (event) => this.release(event));
    on("pointercancel", (event) => this.release(event));
    on("dblclick", (event) => this.addAt(event));
    on("contextmenu", (event) => this.removeAt(event));
    on("wheel", (event) => this.wheel(event), {passive: false});
    on("keydown", (event) => this.key(event));
    on("focusin", (event) => this.select(handleOf(event.target)));
  }

  buildRows() {
    const {form, path} = this;
    const gesture = (kind, change) => (value, options) => this.changeSelected(kind, change, value, options);
    this.valueInput = numberInput(gesture("value", 0), {title: "value"});
    this.opacityInput = numberInput(gesture("opacity", 1), {title: "opacity", empty: true});
    this.colourInput = createElement("input", {type: "color", title: "colour", class: "hidden"});
    this.listenColour();
    this.selectedLabel = createElement("span", {class: "label"}, "Point");
    const remove = button("✕", () => this.removeSelected(), {title: "Remove (Delete)", class: "icon"});
    this.selectedRow = createElement("div", {class: "row selected-row"}, this.selectedLabel, this.valueInput);
    this.selectedRow.append(this.opacityInput, this.colourInput, remove);
    this.removeButton = remove;
    this.picker = new ColourMapPicker(form, `${path}.cmap`, () => this.editColours());
    this.element.append(this.toolRow(), this.wrapper, this.selectedRow, this.picker.element, this.limitRow());
    this.bindKeys();
  }

  toolRow() {
    const zoom = (factor) => () => this.zoomAbout(factor, (this.axis.low + this.axis.high) / 2);
    this.spread = createElement("input", {type: "checkbox", title: "Spread small opacities: cube root"});
    this.spread.addEventListener("change", () => this.setPower(this.spread.checked ? 1 / 3 : 1));
    const names = ["points", ...OPACITY_PRESETS];
    this.shape = createElement("select", {title: "Opacity: control points, or a preset over the colour limits"});
    this.shape.append(...names.map((name) => createElement("option", {value: name}, name)));
    this.shape.addEventListener("change", () => this.takeShape(this.shape.value));
    return createElement(
      "div",
      {class: "row tools"},
      labelledInline("Opacity", this.shape),
      createElement("span", {class: "spacer"}),
      createElement("label", {class: "inline"}, this.spread, "∛"),
      button("−", zoom(2), {title: "Show more values", class: "icon"}),
      button("+", zoom(0.5), {title: "Show fewer values", class: "icon"}),
      button("limits", () => this.showLimits(), {title: "Show the values between the colour limits"}),
      button("all", () => this.showAll(), {title: "Show all values"}),
    );
  }

  limitRow() {
    const change = (at) => (value, options) => this.send("limit", this.limits.with(at, value), options);
    this.limitInputs = [0, 1].map((at) => numberInput(change(at), {title: ["low", "high"][at]}));
    const fit = button("1–99 %", () => this.takePercentiles(), {title: "From the 1st to the 99th percentile"});
    const whole = button("all", () => this.takeRange(), {title: "From the minimum to the maximum"});
    const row = labelled("Colour limits", ...this.limitInputs, fit, whole);
    row.classList.add("vector");
    this.limitButtons = [fit, whole];
    this.rows = {limit: row};
    return row;
  }

  /** Bind the four keys that the plot shows; each element is where errors of its key appear. */
  bindKeys() {
    const bind = (kind, element, show) => this.form.bind(`${this.path}.${HANDLE_KEYS[kind]}`, element, show);
    this.surfaceButton = button("+ isovalue", () => this.addSurface(), {title: "Add an isosurface"});
    const surfaces = createElement("div", {class: "row surfaces"}, this.surfaceButton);
    this.element.append(surfaces);
    this.fields = {
      point: bind("point", this.wrapper, (value, state) => this.takePoints(value, state)),
      surface: bind("surface", surfaces, (value) => (this.surfaces = value ? value.map(surfaceRow) : null)),
      limit: bind("limit", this.rows.limit, (value) => (this.limits = value ?? null)),
    };
    this.fields.colour = this.picker.field;
    this.wrapper.title = "";
  }

  takePoints(value, state) {
    const shown = Array.isArray(value) ? value : (contentEntry(state, this.path).opacity_points ?? []);
    this.points = shown.map((row) => [...row]);
    this.isPreset = typeof value === "string" ? value : null;
  }

  /** Show a state. */
  show(state) {
    const entry = contentEntry(state, this.path);
    this.entry = entry;
    const section = valueAt(state.scene, this.path) ?? {};
    this.form.show(state);
    if (!this.fields.colour.busy) this.takeColours(section, entry);
    this.setRange(entry);
    const hasSurfaces = this.surfaces !== null;
    this.surfaceButton.parentNode.hidden = !hasSurfaces;
    this.choosePower();
    this.limitButtons[0].hidden = !entry.percentiles;
    this.limitButtons[1].hidden = entry.minimum == null;
    this.wrapper.classList.toggle("without-opacity", Boolean(section.transfer_2d));
    showShape(this.shape, this.isPreset);
    this.draw();
  }

  /** Spread small opacities at first if all of them are small. */
  choosePower() {
    if (this.hasChosenPower || !this.points.length) return;
    this.hasChosenPower = true;
    this.spread.checked = Math.max(...this.points.map((point) => point[1])) < 0.25;
    this.axis.power = this.spread.checked ? 1 / 3 : 1;
  }

  setPower(power) {
    this.axis.power = power;
    this.draw();
  }

  takeColours(section, entry) {
    this.followsLimits = !(Array.isArray(section.cmap) && section.cmap[0].length === 4);
    this.colours = this.followsLimits ? null : section.cmap.map((row) => [...row]);
    this.stops = thinned(entry.colour_points ?? [], 64);
    this.stopLimits = section.clim;
  }

  setRange(entry) {
    const values = [entry.minimum, entry.maximum, ...(this.limits ?? []), ...this.points.map((point) => point[0])];
    const known = values.filter((value) => Number.isFinite(value));
    const [low, high] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
    if (this.range?.[0] === low && this.range[1] === high) return;
    const wasWhole = !this.range || this.axis.isWhole();
    this.range = [low, high];
    this.axis.setWhole(low, high);
    if (wasWhole && !this.dragged) this.axis.showWhole();
  }

  draw() {
    this.drawGradient();
    this.histogram.setAttribute("d", histogramPath(this.entry?.histogram, this.axis));
    const line = this.curvePoints().map(([x, y]) => `${x.toFixed(2)},${y.toFixed(2)}`);
    this.curve.setAttribute("d", line.length ? `M${line.join("L")}` : "");
    const {left, right, bottom} = PLOT;
    this.area.setAttribute("d", line.length ? `M${left},${bottom}L${line.join("L")}L${right},${bottom}Z` : "");
    this.drawTicks();
    this.drawHandles();
    this.drawFields();
  }

  curvePoints() {
    if (!this.points.length) return [];
    const count = this.axis.power === 1 ? 1 : CURVE_PARTS;
    const between = ([a, low], [b, high]) =>
      Array.from({length: count}, (_, k) => [a + ((b - a) * k) / count, low + ((high - low) * k) / count]);
    const last = this.points[this.points.length - 1];
    const inner = [...this.points.slice(1).flatMap((point, index) => between(this.points[index], point)), last];
    const placed = inner.map(([value, opacity]) => [this.axis.x(value), this.axis.y(opacity)]);
    const end = placed[placed.length - 1];
    return [[Math.min(placed[0][0], PLOT.left), placed[0][1]], ...placed, [Math.max(end[0], PLOT.right), end[1]]];
  }

  drawGradient() {
    const rows = this.colours ?? this.stops.map(([value, ...rgb]) => [this.atLimits(value), ...rgb]);
    if (!rows.length) return this.gradient.replaceChildren();
    const first = this.axis.x(rows[0][0]);
    const width = Math.max(1e-6, this.axis.x(rows[rows.length - 1][0]) - first);
    changeAttributes(this.gradient, {x1: first, x2: first + width, y1: 0, y2: 0});
    const stop = ([value, ...rgb]) =>
      createSvg("stop", {offset: (this.axis.x(value) - first) / width, "stop-color": hexColour(rgb)});
    return this.gradient.replaceChildren(...rows.map(stop));
  }

  /** A value of the last state's colours, moved with the colour limits. */
  atLimits(value) {
    if (!this.followsLimits || !this.limits || !this.stopLimits) return value;
    const [[a, b], [low, high]] = [this.stopLimits, this.limits];
    return b > a ? low + ((value - a) / (b - a)) * (high - low) : value;
  }

  drawTicks() {
    const texts = this.axis.ticks().map((value) => {
      const x = this.axis.x(value);
      const anchor = x < 24 ? "start" : x > PLOT.width - 24 ? "end" : "middle";
      return createSvg("text", {x, y: PLOT.ticks, "text-anchor": anchor}, formatNumber(value));
    });
    const levels = this.axis.levels().flatMap((opacity) => {
      const y = this.axis.y(opacity);
      const label = createSvg("text", {x: PLOT.left + 3, y: y - 2, class: "level"}, String(opacity));
      return [createSvg("line", {x1: PLOT.left, x2: PLOT.right, y1: y, y2: y}), label];
    });
    this.ticks.replaceChildren(...levels, ...texts);
  }

  /** Every handle with its position; those outside of the visible range are left out. */
  placedHandles() {
    const {points, surfaces, limits, colours} = this;
    const placed = points.map(([value, opacity], index) => ({kind: "point", index, value, opacity}));
    (surfaces ?? []).forEach(([value, opacity], index) => placed.push({kind: "surface", index, value, opacity}));
    (limits ?? []).forEach((value, index) => placed.push({kind: "limit", index, value}));
    (colours ?? []).forEach(([value], index) => placed.push({kind: "colour", index, value}));
    const margin = 0.005 * (this.axis.high - this.axis.low);
    return placed.filter(({value}) => value >= this.axis.low - margin && value <= this.axis.high + margin);
  }

  /** Draw the handles; an element is kept as long as its handle, so that it keeps the focus. */
  drawHandles() {
    const kept = new Map([...this.handles.children].map((child) => [child.dataset.handle, child]));
    for (const handle of this.placedHandles()) {
      const name = `${handle.kind}-${handle.index}`;
      const group = kept.get(name) ?? this.handles.appendChild(newHandle(handle));
      kept.delete(name);
      placeHandle(group, handle, this.axis, this.surfaceOpacity(handle));
      group.classList.toggle("selected", isSameHandle(this.selected, handle));
    }
    kept.forEach((child) => child.remove());
  }

  surfaceOpacity({kind, value, opacity}) {
    return kind === "surface" ? (opacity ?? opacityAt(this.points, value) ?? 1) : opacity;
  }

  drawFields() {
    const row = this.selectedData();
    this.selectedRow.classList.toggle("empty", !row);
    const kind = this.selected?.kind ?? "point";
    this.selectedLabel.textContent = HANDLE_NAMES[kind];
    const hasOpacity = kind === "point" || kind === "surface";
    this.opacityInput.classList.toggle("hidden", !hasOpacity);
    this.colourInput.classList.toggle("hidden", kind !== "colour");
    this.removeButton.classList.toggle("hidden", kind === "limit");
    for (const input of [this.valueInput, this.opacityInput, this.colourInput]) input.disabled = !row;
    this.opacityInput.placeholder = kind === "surface" && row ? formatNumber(opacityAt(this.points, row[0])) : "";
    showText(this.valueInput, row ? formatNumber(row[0]) : "");
    showText(this.opacityInput, row && hasOpacity ? formatNumber(row[1]) : "");
    if (row && kind === "colour") this.colourInput.value = hexColour(row.slice(1));
    this.limitInputs.forEach((input, at) => showText(input, formatNumber(this.limits?.[at])));
  }

  /** The rows of a kind of handles; for limits, rows of one number. */
  rowsOf(kind) {
    if (kind === "limit") return (this.limits ?? []).map((value) => [value]);
    return {point: this.points, surface: this.surfaces ?? [], colour: this.colours ?? []}[kind];
  }

  selectedData() {
    return this.selected && (this.rowsOf(this.selected.kind)[this.selected.index] ?? null);
  }

  select(handle) {
    if (handle) this.selected = handle;
    this.draw();
  }

  focusSelected() {
    const {kind, index} = this.selected;
    this.handles.querySelector(`[data-handle="${kind}-${index}"]`)?.focus();
  }

  /** A value rounded to what the visible range resolves. */
  rounded(value) {
    const digits = Math.ceil(-Math.log10((this.axis.high - this.axis.low) / 2000));
    return digits >= 0 && digits < 16 ? Number(value.toFixed(digits)) : Number(value.toPrecision(5));
  }

  /** Change a handle's row here, then send its key. */
  moveHandle({kind, index}, value, opacity, gesture) {
    const rows = this.rowsOf(kind);
    const row = [...rows[index]];
    row[0] = kind === "surface" ? value : betweenNeighbours(rows, index, value);
    if (kind === "point" || (kind === "surface" && row[1] !== null)) row[1] = opacity ?? row[1];
    this.send(kind, kind === "limit" ? this.limits.with(index, row[0]) : rows.with(index, row), gesture);
  }

  /** Show new rows of a kind of handles, and send them. */
  send(kind, rows, gesture = {}) {
    if (kind === "point") [this.points, this.isPreset] = [rows, null];
    if (kind === "surface") this.surfaces = rows;
    if (kind === "limit") this.limits = rows;
    if (kind === "colour") [this.colours, this.followsLimits] = [rows, false];
    const value = kind === "surface" ? rows.map((row) => (row[1] == null ? row[0] : row)) : rows;
    this.form.send(this.fields[kind], value, gesture);
    this.draw();
  }

  /** Take a field's number for the selected handle; text that is no number is sent as it is, and refused. */
  changeSelected(name, column, value, gesture) {
    if (!this.selected) return;
    const {kind, index} = this.selected;
    if (kind === "limit") {
      this.send("limit", this.limits.with(index, value), gesture);
      return;
    }
    const rows = this.rowsOf(kind);
    const row = rows[index].with(column, value);
    const others = rows.toSpliced(index, 1);
    if (typeof value === "string" || name === "opacity") return void this.send(kind, rows.with(index, row), gesture);
    this.selected = {kind, index: kind === "surface" ? index : insertByValue(others, row)};
    this.send(kind, kind === "surface" ? rows.with(index, row) : others, gesture);
  }

  listenColour() {
    let merge = newGesture("colour");
    const change = (moving) => {
      const {index} = this.selected;
      const row = [this.colours[index][0], ...rgbOfHex(this.colourInput.value)];
      this.send("colour", this.colours.with(index, row), {moving, merge});
    };
    this.colourInput.addEventListener("input", () => change(true));
    this.colourInput.addEventListener("change", () => {
      change(false);
      merge = newGesture("colour");
    });
  }

  place(event) {
    const box = this.svg.getBoundingClientRect();
    const scale = PLOT.width / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  }

  grab(event) {
    if (event.button !== 0) return;
    const handle = handleOf(event.target);
    const [x, y] = this.place(event);
    this.svg.setPointerCapture(event.pointerId);
    this.dragged = {handle: maySteer(this.viewer) ? handle : null, x, y, merge: newGesture(this.path), isMoved: false};
    if (!handle) return;
    this.select(handle);
    this.focusSelected();
    event.preventDefault();
  }

  drag(event) {
    if (!this.dragged) return;
    const [x, y] = this.place(event);
    const {handle, merge} = this.dragged;
    if (!this.dragged.isMoved && Math.hypot(x - this.dragged.x, y - this.dragged.y) < 1.5) return;
    this.dragged.isMoved = true;
    if (handle) return void this.dragHandle(handle, x, y, {moving: true, merge});
    this.axis.pan((this.dragged.x - x) / (PLOT.right - PLOT.left));
    this.dragged.x = x;
    this.draw();
  }

  dragHandle(handle, x, y, gesture) {
    const value = this.rounded(this.axis.value(Math.min(PLOT.right, Math.max(PLOT.left, x))));
    const opacity = this.axis.opacity(y);
    if (handle.kind === "surface") this.giveSurfaceOpacity(handle.index, y);
    this.moveHandle(handle, value, opacity, gesture);
  }

  /** An isovalue's opacity becomes its own once its handle is dragged up or down by more than a little. */
  giveSurfaceOpacity(index, y) {
    const row = this.surfaces[index];
    if (row[1] === null && Math.abs(y - this.dragged.y) > 8) this.surfaces = this.surfaces.with(index, [row[0], 1]);
  }

  release(event) {
    const dragged = this.dragged;
    this.dragged = null;
    if (!dragged?.handle || !dragged.isMoved) return;
    const [x, y] = this.place(event);
    this.dragged = dragged;
    this.dragHandle(dragged.handle, x, y, {moving: false, merge: dragged.merge});
    this.dragged = null;
  }

  addAt(event) {
    if (handleOf(event.target) || !maySteer(this.viewer)) return;
    const [x, y] = this.place(event);
    const value = this.rounded(this.axis.value(x));
    if (y >= PLOT.bar - 2) this.addColour(value);
    else this.addPoint(value, this.axis.opacity(y));
  }

  addPoint(value, opacity) {
    const rows = [...this.points];
    this.selected = {kind: "point", index: insertByValue(rows, [value, opacity])};
    this.send("point", rows);
    this.focusSelected();
  }

  addColour(value) {
    this.editColours(false);
    const rows = [...this.colours];
    this.selected = {kind: "colour", index: insertByValue(rows, [value, ...colourAtValue(rows, value)])};
    rows[this.selected.index].length = 4;
    this.send("colour", rows);
    this.focusSelected();
  }

  /** Turn a named colour map into control points. */
  editColours(isSent = true) {
    if (this.colours) return;
    this.colours = thinned(this.stops.map(([value, ...rgb]) => [this.atLimits(value), ...rgb]), 8);
    this.colours = this.colours.map((row) => [this.rounded(row[0]), ...row.slice(1).map((part) => Number(part.toFixed(4)))]);
    if (isSent) this.send("colour", this.colours);
  }

  addSurface() {
    const [low, high] = [this.axis.low, this.axis.high];
    const value = this.rounded((low + high) / 2);
    this.selected = {kind: "surface", index: this.surfaces.length};
    this.send("surface", [...this.surfaces, [value, null]]);
    this.focusSelected();
  }

  removeAt(event) {
    event.preventDefault();
    const handle = handleOf(event.target);
    if (!handle || !maySteer(this.viewer)) return;
    this.selected = handle;
    this.removeSelected();
  }

  /** Remove the selected handle; the last point of opacity and the last two colours stay. */
  removeSelected() {
    const {kind, index} = this.selected ?? {kind: "limit", index: 0};
    const least = {point: 1, colour: 2, surface: 0, limit: Infinity}[kind];
    const rows = this.rowsOf(kind);
    if (rows.length <= least || !rows[index]) return;
    this.selected = rows.length > 1 ? {kind, index: Math.max(0, index - 1)} : null;
    this.send(kind, rows.toSpliced(index, 1));
    if (this.selected) this.focusSelected();
  }

  takeShape(name) {
    if (name === "points") return void this.send("point", this.points);
    this.form.send(this.fields.point, name);
  }

  takePercentiles() {
    const {percentiles} = this.entry;
    this.send("limit", [percentiles["1"], percentiles["99"]]);
  }

  takeRange() {
    this.send("limit", [this.entry.minimum, this.entry.maximum]);
  }

  wheel(event) {
    event.preventDefault();
    this.zoomAbout(2 ** (event.deltaY / 250), this.axis.value(this.place(event)[0]));
  }

  zoomAbout(factor, value) {
    this.axis.zoom(factor, value);
    this.draw();
  }

  showAll() {
    this.axis.showWhole();
    this.draw();
  }

  showLimits() {
    const [low, high] = this.limits ?? this.axis.whole;
    const margin = 0.05 * (high - low) || 0.01 * Math.abs(low);
    this.axis.showRange(low - margin, high + margin);
    this.draw();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const middle = (this.axis.low + this.axis.high) / 2;
    const zoom = {"+": () => this.zoomAbout(0.5, middle), "-": () => this.zoomAbout(2, middle), 0: () => this.showAll()};
    const edit = {Delete: () => this.removeSelected(), Backspace: () => this.removeSelected(), Insert: () => this.addBeside()};
    const act = zoom[event.key] ?? (maySteer(this.viewer) ? (edit[event.key] ?? this.arrow(event)) : null);
    if (!act) return;
    event.preventDefault();
    event.stopPropagation();
    act();
  }

  arrow(event) {
    const [right, up] = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[event.key] ?? [0, 0];
    const row = this.selectedData();
    if (!row || (!right && !up)) return null;
    const factor = event.shiftKey ? 10 : 1;
    const value = this.rounded(row[0] + (right * factor * (this.axis.high - this.axis.low)) / 200);
    const opacity = row[1] == null ? null : Number(Math.min(1, Math.max(0, row[1] + 0.01 * up * factor)).toFixed(3));
    const {kind, index} = this.selected;
    return () => this.moveHandle(this.selected, value, opacity, {merge: `${this.path} keys ${kind} ${index}`});
  }

  /** Add a point halfway to the next one. */
  addBeside() {
    if (this.selected?.kind !== "point") return;
    const [here, next] = [this.points[this.selected.index], this.points[this.selected.index + 1]];
    const value = next ? (here[0] + next[0]) / 2 : (here[0] + this.axis.high) / 2;
    this.addPoint(this.rounded(value), Number(opacityAt(this.points, value).toFixed(4)));
  }
}

function labelledInline(label, control) {
  control.setAttribute("aria-label", label);
  return createElement("span", {class: "inline"}, createElement("span", {class: "label"}, label), control);
}

function showShape(select, preset) {
  const name = preset ?? "points";
  if (![...select.options].some((option) => option.value === name)) select.append(createElement("option", {value: name}, name));
  select.value = name;
}

/** [value, opacity] of an isosurface; null for the opacity of the transfer function. */
function surfaceRow(surface) {
  return Array.isArray(surface) ? [...surface] : [surface, null];
}

/** At most so many rows, at equal distances and with both ends. */
function thinned(rows, most) {
  if (rows.length <= most) return rows;
  return Array.from({length: most}, (_, at) => rows[Math.round((at * (rows.length - 1)) / (most - 1))]);
}

function colourAtValue(rows, value) {
  return [1, 2, 3].map((part) => Number(opacityAt(rows.map((row) => [row[0], row[part]]), value).toFixed(4)));
}

/** The handle that an element belongs to, or null. */
function handleOf(element) {
  const name = element.closest?.("[data-handle]")?.dataset.handle;
  if (!name) return null;
  const [kind, index] = name.split("-");
  return {kind, index: Number(index)};
}

function isSameHandle(a, b) {
  return a?.kind === b.kind && a.index === b.index;
}

function newHandle({kind, index}) {
  const shapes = {
    point: () => [createSvg("circle", {r: 11, class: "reach"}), createSvg("circle", {r: 5})],
    colour: () => [createSvg("circle", {r: 9, class: "reach"}), createSvg("path", {d: "M0,-6L5,0L0,6L-5,0Z"})],
    surface: () => [createSvg("line"), createSvg("circle", {r: 11, class: "reach"}), createSvg("path", {d: "M-5,-5H5V5H-5Z"})],
    limit: () => [createSvg("line"), createSvg("circle", {r: 9, class: "reach"}), createSvg("path", {d: "M0,-7L6,4H-6Z"})],
  };
  const attributes = {class: `handle ${kind}`, tabindex: 0, role: "slider", "data-handle": `${kind}-${index}`};
  return createSvg("g", attributes, ...shapes[kind]());
}

function placeHandle(group, {kind, index, value}, axis, opacity) {
  const y = {limit: PLOT.barBottom + 3, colour: (PLOT.bar + PLOT.barBottom) / 2}[kind] ?? axis.y(opacity);
  group.setAttribute("transform", `translate(${axis.x(value).toFixed(2)},${y.toFixed(2)})`);
  const line = group.querySelector("line");
  if (line) changeAttributes(line, {x1: 0, x2: 0, y1: PLOT.top - y, y2: (kind === "limit" ? PLOT.barBottom : PLOT.bottom) - y});
  const text = opacity == null ? formatNumber(value) : `value ${formatNumber(value)}, opacity ${formatNumber(opacity)}`;
  const label = `${HANDLE_NAMES[kind]} ${index + 1}: ${text}`;
  changeAttributes(group, {"aria-label": label, "aria-valuenow": value, "aria-valuetext": text});
}
