// Axes of the transfer function's editor: visible values, opacities, ticks and the histogram.

/** @typedef {{low: number, high: number, counts: number[]}} Histogram */

/** The editor's parts, in units of its view box. */
export const PLOT = {
  left: 6, right: 334, top: 14, bottom: 138, bar: 144, barBottom: 158, ticks: 177, width: 340, height: 181,
};

/** The visible part of the value axis, and the opacity axis. */
export class PlotAxes {
  constructor(low, high) {
    this.setWhole(low, high);
    this.showWhole();
    /** Power of the opacity axis: 1, or 1/3, which spreads small opacities. */
    this.power = 1;
  }

  /** Set the range that zooming out ends at. */
  setWhole(low, high) {
    const margin = high > low ? 0.02 * (high - low) : Math.abs(low) * 0.01 || 1;
    this.whole = [low - margin, high + margin];
  }

  showWhole() {
    [this.low, this.high] = this.whole;
  }

  /** Show a range, within the whole one. */
  showRange(low, high) {
    const [least, most] = this.whole;
    const width = Math.min(Math.max(high - low, 1e-5 * (most - least)), most - least);
    this.low = Math.min(Math.max(low, least), most - width);
    this.high = this.low + width;
  }

  /** Scale the visible range about a value. */
  zoom(factor, value) {
    this.showRange(value - (value - this.low) * factor, value + (this.high - value) * factor);
  }

  /** Move the visible range by a share of its width. */
  pan(share) {
    const step = share * (this.high - this.low);
    this.showRange(this.low + step, this.high + step);
  }

  x(value) {
    return PLOT.left + ((value - this.low) / (this.high - this.low)) * (PLOT.right - PLOT.left);
  }

  value(x) {
    return this.low + ((x - PLOT.left) / (PLOT.right - PLOT.left)) * (this.high - this.low);
  }

  /** y of an opacity in 0..1. */
  y(opacity) {
    return yOfShare(opacity ** this.power);
  }

  /** Opacity in 0..1 at y, with three digits. */
  opacity(y) {
    const share = Math.min(1, Math.max(0, (PLOT.bottom - y) / (PLOT.bottom - PLOT.top)));
    return Number((share ** (1 / this.power)).toPrecision(3));
  }

  /** Opacities at which there is a line across the plot. */
  levels() {
    return this.power === 1 ? [0.25, 0.5, 0.75] : [0.01, 0.1, 0.5];
  }

  isWhole() {
    return this.low === this.whole[0] && this.high === this.whole[1];
  }

  /** Three to seven round values. */
  ticks() {
    const raw = (this.high - this.low) / 5;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= raw) ?? raw;
    const found = [];
    for (let n = Math.ceil(this.low / step); n * step <= this.high && found.length < 8; n += 1) found.push(n * step);
    return found.map((value) => Number(value.toPrecision(12)));
  }
}

/** y of a share of the plot's height. */
function yOfShare(share) {
  return PLOT.bottom - share * (PLOT.bottom - PLOT.top);
}

/**
 * SVG path of a histogram's log counts over the visible range.
 * @param {Histogram | null | undefined} histogram
 * @param {PlotAxes} axis
 */
export function histogramPath(histogram, axis) {
  if (!histogram?.counts.length) return "";
  const {low, high, counts} = histogram;
  const most = Math.log1p(Math.max(...counts)) || 1;
  const edge = (bin) => Math.min(PLOT.right, Math.max(PLOT.left, axis.x(low + ((high - low) * bin) / counts.length)));
  const steps = counts.map((count, bin) => {
    const y = yOfShare((0.97 * Math.log1p(count)) / most).toFixed(1);
    return `L${edge(bin).toFixed(1)},${y}L${edge(bin + 1).toFixed(1)},${y}`;
  });
  return `M${edge(0).toFixed(1)},${PLOT.bottom}${steps.join("")}L${edge(counts.length).toFixed(1)},${PLOT.bottom}Z`;
}
