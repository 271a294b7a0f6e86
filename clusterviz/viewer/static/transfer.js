// Editor of a transfer function: colour, opacity, isovalues and colour limits over the histogram.

import {ColourMapPicker} from "./colours.js";
import {
  Form, button, formatNumber, hexColour, labelled, newGesture, numberInput, rgbOfHex, showText, valueAt,
} from "./controls.js";
import {createElement} from "./elements.js";
import {PLOT} from "./histogram.js";
import {TransferModel, betweenNeighbours, columnAt, contentEntry, insertByValue} from "./transfer_model.js";
import {HANDLE_NAMES, TransferPlot, handleOf} from "./transfer_plot.js";

const OPACITY_PRESETS = ["linear", "linear_r", "geom", "geom_r", "sigmoid", "sigmoid_r", "foreground"];
const HANDLE_KEYS = {point: "opacity", surface: "isosurfaces", limit: "clim", colour: "cmap"};
/** Rows that stay when others are removed. */
const LEAST_ROWS = {point: 1, colour: 2, surface: 0, limit: 2};
/** Largest opacity up to which small opacities are spread at first. */
const SPREAD_BELOW = 0.25;
const CLICK_UNITS = 1.5;
/** Way up or down after which an isovalue gets an opacity of its own, units of the plot. */
const OWN_OPACITY_UNITS = 8;
const ARROW_DIRECTIONS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};

export class TransferEditor {
  /**
   * @param {import("./viewer.js").Viewer} viewer
   * @param {string} path  the section, such as "volumes.0"
   */
  constructor(viewer, path) {
    this.viewer = viewer;
    this.path = path;
    this.form = new Form(viewer);
    this.model = new TransferModel();
    this.plot = new TransferPlot();
    this.entry = {};
    /** @type {?import("./transfer_model.js").Handle} */
    this.selected = null;
    this.dragged = null;
    this.frame = createElement("div", {class: "plot-frame"}, this.plot.element);
    this.picker = new ColourMapPicker(this.form, `${path}.cmap`, () => this.editColours());
    this.addSurfaceButton = button("+ isovalue", () => this.addSurface(), {title: "Add an isosurface"});
    this.surfaceRow = createElement("div", {class: "row"}, this.addSurfaceButton);
    this.element = createElement("div", {class: "transfer"}, this.toolRow(), this.frame, this.selectedRow());
    this.element.append(this.picker.element, this.limitRow(), this.surfaceRow);
    this.bindKeys();
    this.listen();
  }

  // Rows ---------------------------------------------------------------------------------------------------------

  toolRow() {
    const {axes} = this.plot;
    const zoom = (factor) => () => this.zoom(factor, (axes.low + axes.high) / 2);
    this.spread = createElement("input", {type: "checkbox"});
    this.spread.addEventListener("change", () => this.setSpread(this.spread.checked));
    const names = ["points", ...OPACITY_PRESETS];
    const about = {title: "Control points, or a preset over the colour limits", "aria-label": "Opacity"};
    this.shape = createElement("select", about, ...names.map((name) => createElement("option", {value: name}, name)));
    this.shape.addEventListener("change", () => this.takeShape(this.shape.value));
    const spread = createElement("label", {class: "inline", title: "Spread small opacities"}, this.spread, "spread");
    return createElement(
      "div", {class: "row tools"},
      createElement("span", {class: "inline"}, "Opacity", this.shape), spread,
      createElement("span", {class: "spacer"}),
      button("−", zoom(2), {title: "Show more values", class: "icon"}),
      button("+", zoom(0.5), {title: "Show fewer values", class: "icon"}),
      button("⟷", () => this.showLimits(), {title: "Show the values between the colour limits", class: "icon"}),
      button("all", () => this.showAll(), {title: "Show all values"}),
    );
  }

  selectedRow() {
    const change = (column) => (value, gesture) => this.changeSelected(column, value, gesture);
    this.valueInput = numberInput(change(0), {title: "value"});
    this.opacityInput = numberInput(change(1), {title: "opacity", empty: true});
    this.colourInput = createElement("input", {type: "color", title: "colour"});
    this.listenColour();
    this.selectedLabel = createElement("span", {class: "label"}, "Point");
    this.removeButton = button("✕", () => this.removeSelected(), {title: "Remove (Delete)", class: "icon"});
    const inputs = [this.valueInput, this.opacityInput, this.colourInput, this.removeButton];
    this.selectedLine = createElement("div", {class: "row selected-row"}, this.selectedLabel, ...inputs);
    const hint = createElement("span", {class: "hint"}, "Double click adds a point, right click removes it.");
    this.selectedLine.append(hint);
    return this.selectedLine;
  }

  limitRow() {
    const change = (index) => (value, gesture) => {
      this.model.limits = this.model.limits.with(index, value);
      this.send("limit", gesture);
    };
    this.limitInputs = ["low", "high"].map((title, index) => numberInput(change(index), {title}));
    const fit = button("1–99 %", () => this.takePercentiles(), {title: "From the 1st to the 99th percentile"});
    const whole = button("all", () => this.takeRange(), {title: "From the minimum to the maximum"});
    this.limitButtons = [fit, whole];
    this.limitLine = labelled("Limits", ...this.limitInputs, fit, whole);
    this.limitLine.classList.add("vector");
    return this.limitLine;
  }

  /** Bind the keys that the plot shows; each element is where errors of its key appear. */
  bindKeys() {
    const {model} = this;
    const bind = (kind, element, show) => this.form.bind(`${this.path}.${HANDLE_KEYS[kind]}`, element, show);
    const limits = (state) => valueAt(state.scene, this.path).clim;
    this.fields = {
      point: bind("point", this.frame, (value, state) => model.takeOpacity(value, this.entry, limits(state))),
      surface: bind("surface", this.surfaceRow, (value) => model.takeSurfaces(value)),
      limit: bind("limit", this.limitLine, (value) => (model.limits = value ?? null)),
      colour: this.picker.field,
    };
    this.frame.title = "";
    const showPicker = this.fields.colour.show;
    this.fields.colour.show = (value, state) => {
      showPicker(value, state);
      model.takeColours(value, this.entry, limits(state));
    };
  }

  // What is shown ------------------------------------------------------------------------------------------------

  /** Show a state. */
  show(state) {
    this.entry = contentEntry(state, this.path);
    this.form.show(state);
    const {minimum, percentiles} = this.entry;
    this.setRange();
    this.chooseSpread();
    this.surfaceRow.hidden = this.model.surfaces === null;
    this.limitButtons[0].hidden = !percentiles;
    this.limitButtons[1].hidden = minimum == null;
    this.frame.classList.toggle("without-opacity", Boolean(valueAt(state.scene, this.path)?.transfer_2d));
    this.draw();
  }

  setRange() {
    const {axes} = this.plot;
    const range = this.model.range(this.entry);
    if (this.range?.[0] === range[0] && this.range[1] === range[1]) return;
    const wasWhole = !this.range || axes.isWhole();
    this.range = range;
    axes.setWhole(...range);
    if (wasWhole && !this.dragged) axes.showWhole();
  }

  /** Spread small opacities at first if all of them are small. */
  chooseSpread() {
    if (this.hasChosenSpread || !this.model.points.length) return;
    this.hasChosenSpread = true;
    this.spread.checked = Math.max(...this.model.points.map((point) => point[1])) < SPREAD_BELOW;
    this.plot.axes.power = this.spread.checked ? 1 / 3 : 1;
  }

  setSpread(isSpread) {
    this.plot.axes.power = isSpread ? 1 / 3 : 1;
    this.draw();
  }

  draw() {
    this.plot.draw(this.model, this.entry.histogram, this.selected);
    this.drawSelected();
    this.limitInputs.forEach((input, at) => showText(input, formatNumber(this.model.limits?.[at])));
    const name = this.model.preset ?? "points";
    const isKnown = [...this.shape.options].some((option) => option.value === name);
    if (!isKnown) this.shape.append(createElement("option", {value: name}, name));
    this.shape.value = name;
  }

  drawSelected() {
    const row = this.model.row(this.selected);
    const kind = this.selected?.kind ?? "point";
    const hasOpacity = kind === "point" || kind === "surface";
    this.selectedLine.classList.toggle("empty", !row);
    this.selectedLabel.textContent = HANDLE_NAMES[kind];
    this.opacityInput.hidden = !hasOpacity;
    this.colourInput.hidden = kind !== "colour";
    this.removeButton.hidden = kind === "limit";
    const inputs = [this.valueInput, this.opacityInput, this.colourInput, this.removeButton];
    inputs.forEach((input) => (input.disabled = !row));
    const isSurface = row && kind === "surface";
    this.opacityInput.placeholder = isSurface ? formatNumber(columnAt(this.model.points, row[0])) : "";
    showText(this.valueInput, row ? formatNumber(row[0]) : "");
    showText(this.opacityInput, row && hasOpacity ? formatNumber(row[1]) : "");
    if (row && kind === "colour") this.colourInput.value = hexColour(row.slice(1));
  }

  zoom(factor, value) {
    this.plot.axes.zoom(factor, value);
    this.draw();
  }

  showAll() {
    this.plot.axes.showWhole();
    this.draw();
  }

  showLimits() {
    const {axes} = this.plot;
    const [low, high] = this.model.limits ?? axes.whole;
    const margin = 0.05 * (high - low) || 0.01 * Math.abs(low);
    axes.showRange(low - margin, high + margin);
    this.draw();
  }

  // Edits --------------------------------------------------------------------------------------------------------

  /** Send a kind's rows, and draw them. */
  send(kind, gesture = {}) {
    this.form.send(this.fields[kind], this.model.sceneValue(kind), gesture);
    this.draw();
  }

  sendRows(kind, rows, gesture = {}) {
    this.model.setRows(kind, rows);
    this.send(kind, gesture);
  }

  /** Move a handle to a value and, where it has one, an opacity. */
  moveHandle({kind, index}, value, opacity, gesture) {
    const rows = this.model.rows(kind);
    const row = [...rows[index]];
    row[0] = kind === "surface" ? value : betweenNeighbours(rows, index, value);
    const hasOpacity = kind === "point" || (kind === "surface" && row[1] !== null);
    if (hasOpacity) row[1] = opacity ?? row[1];
    this.sendRows(kind, rows.with(index, row), gesture);
  }

  /** Take a field's value for the selected handle; text that is no number is sent as it is, and refused. */
  changeSelected(column, value, gesture) {
    const row = this.model.row(this.selected);
    if (!row) return;
    const {kind, index} = this.selected;
    const rows = this.model.rows(kind);
    const changed = row.with(column, value);
    const isOrdered = column > 0 || kind === "surface" || kind === "limit" || typeof value === "string";
    if (isOrdered) return void this.sendRows(kind, rows.with(index, changed), gesture);
    const others = rows.toSpliced(index, 1);
    this.selected = {kind, index: insertByValue(others, changed)};
    this.sendRows(kind, others, gesture);
  }

  listenColour() {
    let merge = newGesture("colour");
    const change = (moving) => {
      const {index} = this.selected;
      const row = [this.model.colours[index][0], ...rgbOfHex(this.colourInput.value)];
      this.sendRows("colour", this.model.colours.with(index, row), {moving, merge});
    };
    this.colourInput.addEventListener("input", () => change(true));
    this.colourInput.addEventListener("change", () => {
      change(false);
      merge = newGesture("colour");
    });
  }

  add(kind, row) {
    const rows = [...this.model.rows(kind)];
    const index = kind === "surface" ? rows.push(row) - 1 : insertByValue(rows, row);
    this.selected = {kind, index};
    this.sendRows(kind, rows);
    this.plot.focus(this.selected);
  }

  addColour(value) {
    this.model.editColours((one) => this.rounded(one));
    const rgb = [1, 2, 3].map((part) => Number(columnAt(this.model.colours, value, part).toFixed(4)));
    this.add("colour", [value, ...rgb]);
  }

  addSurface() {
    const {low, high} = this.plot.axes;
    this.add("surface", [this.rounded((low + high) / 2), null]);
  }

  /** Add a point halfway to the next one. */
  addBeside() {
    if (this.selected?.kind !== "point") return;
    const {points} = this.model;
    const [here, next] = [points[this.selected.index], points[this.selected.index + 1]];
    const value = next ? (here[0] + next[0]) / 2 : (here[0] + this.plot.axes.high) / 2;
    this.add("point", [this.rounded(value), Number(columnAt(points, value).toFixed(4))]);
  }

  /** Turn a named colour map into control points. */
  editColours() {
    this.model.editColours((value) => this.rounded(value));
    this.send("colour");
  }

  removeSelected() {
    if (!this.model.row(this.selected)) return;
    const {kind, index} = this.selected;
    const rows = this.model.rows(kind);
    if (rows.length <= LEAST_ROWS[kind]) return;
    this.selected = rows.length > 1 ? {kind, index: Math.max(0, index - 1)} : null;
    this.sendRows(kind, rows.toSpliced(index, 1));
    if (this.selected) this.plot.focus(this.selected);
  }

  takeShape(name) {
    if (name === "points") this.sendRows("point", this.model.points);
    else this.form.send(this.fields.point, name);
  }

  takePercentiles() {
    const {percentiles} = this.entry;
    this.sendRows("limit", [[percentiles["1"]], [percentiles["99"]]]);
  }

  takeRange() {
    this.sendRows("limit", [[this.entry.minimum], [this.entry.maximum]]);
  }

  /** A value rounded to what the visible range resolves. */
  rounded(value) {
    const {low, high} = this.plot.axes;
    const digits = Math.ceil(-Math.log10((high - low) / 2000));
    return digits >= 0 && digits < 16 ? Number(value.toFixed(digits)) : Number(value.toPrecision(5));
  }

  // Pointer and keys ---------------------------------------------------------------------------------------------

  listen() {
    const on = (name, react, options) => this.plot.element.addEventListener(name, react, options);
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

  select(handle) {
    if (handle) this.selected = handle;
    this.draw();
  }

  grab(event) {
    if (event.button !== 0) return;
    const handle = handleOf(event.target);
    const [x, y] = this.plot.place(event);
    this.plot.element.setPointerCapture(event.pointerId);
    const moved = this.viewer.steers ? handle : null;
    this.dragged = {handle: moved, x, y, merge: newGesture(this.path), isMoved: false};
    if (!handle) return;
    this.select(handle);
    this.plot.focus(handle);
    event.preventDefault();
  }

  drag(event) {
    if (!this.dragged) return;
    const [x, y] = this.plot.place(event);
    const {handle} = this.dragged;
    if (!this.dragged.isMoved && Math.hypot(x - this.dragged.x, y - this.dragged.y) < CLICK_UNITS) return;
    this.dragged.isMoved = true;
    if (handle) return void this.dragHandle(x, y, true);
    this.plot.axes.pan((this.dragged.x - x) / (PLOT.right - PLOT.left));
    this.dragged.x = x;
    this.draw();
  }

  dragHandle(x, y, moving) {
    const {axes} = this.plot;
    const {handle, merge, y: start} = this.dragged;
    const value = this.rounded(axes.value(Math.min(PLOT.right, Math.max(PLOT.left, x))));
    const row = this.model.row(handle);
    if (!row) return;
    // An isovalue's opacity becomes its own once it is dragged up or down by more than a little.
    if (handle.kind === "surface" && row[1] === null && Math.abs(y - start) > OWN_OPACITY_UNITS) {
      this.model.surfaces = this.model.surfaces.with(handle.index, [row[0], 1]);
    }
    this.moveHandle(handle, value, axes.opacity(y), {moving, merge});
  }

  release(event) {
    if (this.dragged?.handle && this.dragged.isMoved) this.dragHandle(...this.plot.place(event), false);
    this.dragged = null;
  }

  addAt(event) {
    if (handleOf(event.target) || !this.viewer.steers) return;
    const [x, y] = this.plot.place(event);
    const value = this.rounded(this.plot.axes.value(x));
    if (y >= PLOT.bar - 2) this.addColour(value);
    else this.add("point", [value, this.plot.axes.opacity(y)]);
  }

  removeAt(event) {
    event.preventDefault();
    const handle = handleOf(event.target);
    if (!handle || !this.viewer.steers) return;
    this.selected = handle;
    this.removeSelected();
  }

  wheel(event) {
    event.preventDefault();
    this.zoom(2 ** (event.deltaY / 250), this.plot.axes.value(this.plot.place(event)[0]));
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const act = this.viewAction(event.key) ?? (this.viewer.steers ? this.editAction(event) : null);
    if (!act) return;
    event.preventDefault();
    event.stopPropagation();
    act();
  }

  viewAction(key) {
    const middle = (this.plot.axes.low + this.plot.axes.high) / 2;
    return {"+": () => this.zoom(0.5, middle), "-": () => this.zoom(2, middle), 0: () => this.showAll()}[key];
  }

  editAction(event) {
    const remove = () => this.removeSelected();
    const act = {Delete: remove, Backspace: remove, Insert: () => this.addBeside()}[event.key];
    return act ?? this.arrowAction(event);
  }

  arrowAction({key, shiftKey}) {
    const row = this.model.row(this.selected);
    if (!row || !(key in ARROW_DIRECTIONS)) return null;
    const {low, high} = this.plot.axes;
    const [right, up] = ARROW_DIRECTIONS[key].map((step) => step * (shiftKey ? 10 : 1));
    const value = right ? this.rounded(row[0] + (right * (high - low)) / 200) : row[0];
    const opacity = row[1] == null ? null : Number(Math.min(1, Math.max(0, row[1] + 0.01 * up)).toFixed(3));
    const {kind, index} = this.selected;
    return () => this.moveHandle(this.selected, value, opacity, {merge: `${this.path} keys ${kind} ${index}`});
  }
}
