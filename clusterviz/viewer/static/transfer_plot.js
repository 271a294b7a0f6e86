// Plot of a transfer function: histogram, curve of opacity, bar of colours, and handles.

import {changeAttributes, createSvg, formatNumber, hexColour} from "./controls.js";
import {PLOT, PlotAxes, histogramPath} from "./histogram.js";

/** @typedef {import("./transfer_model.js").Handle} Handle */

/** Parts of the curve between two points where the opacity axis is not linear. */
const CURVE_PARTS = 16;
export const HANDLE_NAMES = {point: "Point", surface: "Isovalue", limit: "Colour limit", colour: "Colour point"};

export class TransferPlot {
  constructor() {
    this.axes = new PlotAxes(0, 1);
    // Several plots may be on a page that holds the module several times, as a notebook does.
    const id = `transfer-${Math.random().toString(36).slice(2)}`;
    const size = {x: PLOT.left, width: PLOT.right - PLOT.left};
    this.gradient = createSvg("linearGradient", {id, gradientUnits: "userSpaceOnUse"});
    this.histogram = createSvg("path", {class: "histogram"});
    this.area = createSvg("path", {class: "area", fill: `url(#${id})`});
    this.curve = createSvg("path", {class: "curve"});
    this.ticks = createSvg("g", {class: "ticks"});
    this.handles = createSvg("g");
    const clip = createSvg("clipPath", {id: `${id}-clip`}, createSvg("rect", {...size, y: 0, height: PLOT.bottom + 1}));
    this.element = createSvg(
      "svg",
      {viewBox: `0 0 ${PLOT.width} ${PLOT.height}`, class: "plot", tabindex: 0, role: "group"},
      createSvg("defs", {}, this.gradient, clip),
      createSvg("rect", {...size, y: PLOT.top, height: PLOT.bottom - PLOT.top, class: "plot-background"}),
      createSvg("g", {"clip-path": `url(#${id}-clip)`}, this.histogram, this.area, this.curve),
      createSvg("rect", {
        ...size, y: PLOT.bar, height: PLOT.barBottom - PLOT.bar, fill: `url(#${id})`, class: "colour-bar",
      }),
      this.ticks,
      this.handles,
    );
    this.element.ariaLabel = "Transfer function: double click adds a point, + and - zoom, 0 shows all values";
  }

  /**
   * @param {import("./transfer_model.js").TransferModel} model
   * @param {?import("./histogram.js").Histogram} histogram
   * @param {?Handle} selected
   */
  draw(model, histogram, selected) {
    this.drawGradient(model.colourRows());
    this.histogram.setAttribute("d", histogramPath(histogram, this.axes));
    this.drawCurve(model.points);
    this.drawTicks();
    this.drawHandles(model.handles(), selected);
  }

  drawGradient(rows) {
    const places = rows.map(([value]) => this.axes.x(value));
    const [first, last] = [places[0] ?? 0, places[places.length - 1] ?? 0];
    const width = Math.max(1e-6, last - first);
    changeAttributes(this.gradient, {x1: first, x2: first + width, y1: 0, y2: 0});
    const stops = rows.map(([, ...rgb], index) =>
      createSvg("stop", {offset: (places[index] - first) / width, "stop-color": hexColour(rgb)}),
    );
    this.gradient.replaceChildren(...stops);
  }

  drawCurve(points) {
    const line = this.curvePoints(points).map(([x, y]) => `${x.toFixed(2)},${y.toFixed(2)}`);
    const {left, right, bottom} = PLOT;
    this.curve.setAttribute("d", line.length ? `M${line.join("L")}` : "");
    this.area.setAttribute("d", line.length ? `M${left},${bottom}L${line.join("L")}L${right},${bottom}Z` : "");
  }

  curvePoints(points) {
    if (!points.length) return [];
    const count = this.axes.power === 1 ? 1 : CURVE_PARTS;
    const between = ([a, low], [b, high]) =>
      Array.from({length: count}, (_, k) => [a + ((b - a) * k) / count, low + ((high - low) * k) / count]);
    const last = points[points.length - 1];
    const inner = [...points.slice(1).flatMap((point, index) => between(points[index], point)), last];
    const placed = inner.map(([value, opacity]) => [this.axes.x(value), this.axes.y(opacity)]);
    const end = placed[placed.length - 1];
    return [[Math.min(placed[0][0], PLOT.left), placed[0][1]], ...placed, [Math.max(end[0], PLOT.right), end[1]]];
  }

  drawTicks() {
    const texts = this.axes.ticks().map((value) => {
      const x = this.axes.x(value);
      const anchor = x < 24 ? "start" : x > PLOT.width - 24 ? "end" : "middle";
      return createSvg("text", {x, y: PLOT.ticks, "text-anchor": anchor}, formatNumber(value));
    });
    const levels = this.axes.levels().flatMap((opacity) => {
      const y = this.axes.y(opacity);
      const label = createSvg("text", {x: PLOT.left + 3, y: y - 2, class: "level"}, String(opacity));
      return [createSvg("line", {x1: PLOT.left, x2: PLOT.right, y1: y, y2: y}), label];
    });
    this.ticks.replaceChildren(...levels, ...texts);
  }

  /** Draw the handles in sight; an element is kept as long as its handle, so that it keeps the focus. */
  drawHandles(handles, selected) {
    const kept = new Map([...this.handles.children].map((child) => [child.dataset.handle, child]));
    const {low, high} = this.axes;
    const margin = 0.005 * (high - low);
    for (const handle of handles.filter(({value}) => value >= low - margin && value <= high + margin)) {
      const name = `${handle.kind}-${handle.index}`;
      const group = kept.get(name) ?? this.handles.appendChild(newHandle(handle));
      kept.delete(name);
      placeHandle(group, handle, this.axes);
      group.classList.toggle("selected", selected?.kind === handle.kind && selected.index === handle.index);
    }
    kept.forEach((child) => child.remove());
  }

  focus({kind, index}) {
    this.handles.querySelector(`[data-handle="${kind}-${index}"]`)?.focus();
  }

  /** Place of a pointer in the view box. @returns {[number, number]} */
  place(event) {
    const box = this.element.getBoundingClientRect();
    const scale = PLOT.width / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  }
}

/** The handle that an element belongs to, or null. @returns {?Handle} */
export function handleOf(element) {
  const name = element.closest?.("[data-handle]")?.dataset.handle;
  if (!name) return null;
  const [kind, index] = name.split("-");
  return {kind, index: Number(index)};
}

function newHandle({kind, index}) {
  const reach = createSvg("circle", {r: kind === "point" || kind === "surface" ? 11 : 9, class: "reach"});
  const shapes = {
    point: [createSvg("circle", {r: 5})],
    colour: [createSvg("path", {d: "M0,-6L5,0L0,6L-5,0Z"})],
    surface: [createSvg("line"), createSvg("path", {d: "M-5,-5H5V5H-5Z"})],
    limit: [createSvg("line"), createSvg("path", {d: "M0,-7L6,4H-6Z"})],
  };
  const attributes = {class: `handle ${kind}`, tabindex: 0, role: "slider", "data-handle": `${kind}-${index}`};
  return createSvg("g", attributes, reach, ...shapes[kind]);
}

function placeHandle(group, {kind, index, value, opacity}, axes) {
  const y = {limit: PLOT.barBottom + 3, colour: (PLOT.bar + PLOT.barBottom) / 2}[kind] ?? axes.y(opacity);
  group.setAttribute("transform", `translate(${axes.x(value).toFixed(2)},${y.toFixed(2)})`);
  const line = group.querySelector("line");
  const end = kind === "limit" ? PLOT.barBottom : PLOT.bottom;
  if (line) changeAttributes(line, {x1: 0, x2: 0, y1: PLOT.top - y, y2: end - y});
  const parts = [`value ${formatNumber(value)}`, ...(opacity == null ? [] : [`opacity ${formatNumber(opacity)}`])];
  const label = `${HANDLE_NAMES[kind]} ${index + 1}: ${parts.join(", ")}`;
  changeAttributes(group, {"aria-label": label, "aria-valuenow": value, "aria-valuetext": parts.join(", ")});
}
