// Panel of the statistics: time by stage and rank, samples, imbalance, bytes and memory.

import {createElement} from "./elements.js";
import {rankColour} from "./overlay.js";
import {formatSeconds} from "./quality.js";

/** Colours of stages, apart for the colour blind (Okabe and Ito), and grey for the rest of the time. */
const STAGE_COLOURS = {
  plan: "#999933",
  load: "#e69f00",
  render: "#3b8fd6",
  readback: "#56b4e9",
  encode: "#cc79a7",
  exchange: "#d55e00",
  blend: "#009e73",
  collect: "#aa4499",
  finish: "#b8a000",
  kernels: "#7570b3",
  other: "#8888887f",
};
/** Share of the frame's time from which on a stage is in the legend. */
const LEAST_SHARE = 0.001;

/** Bytes as "1.2 MiB". */
export function formatBytes(bytes) {
  if (bytes == null) return "–";
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  const power = Math.min(units.length - 1, Math.max(0, Math.floor(Math.log2(Math.max(1, bytes)) / 10)));
  return `${Number((bytes / 1024 ** power).toPrecision(3))} ${units[power]}`;
}

/** A count as "12.3 M". */
export function formatCount(count) {
  if (count == null) return "–";
  const [unit, size] = [["G", 1e9], ["M", 1e6], ["k", 1e3]].find(([, least]) => count >= least) ?? ["", 1];
  return `${Number((count / size).toPrecision(3))}${unit && " "}${unit}`;
}

/**
 * Parts of a rank's bar: its stages, and the rest of the frame's time.
 * @returns {{stage: string, seconds: number}[]}
 */
export function stageParts(rank, stages, total) {
  const parts = stages.map((stage) => ({stage, seconds: rank.seconds?.[stage] ?? 0}));
  const known = parts.reduce((sum, part) => sum + part.seconds, 0);
  return [...parts, {stage: "other", seconds: Math.max(0, total - known)}].filter((part) => part.seconds > 0);
}

export class StatisticsPanel {
  constructor(viewer) {
    this.viewer = viewer;
    this.total = createElement("div", {class: "total"}, "No picture yet.");
    this.bars = createElement("div", {class: "bars"});
    this.legend = createElement("div", {class: "legend"});
    this.table = createElement("table");
    this.boxes = createElement("input", {type: "checkbox"});
    this.boxes.addEventListener("change", () => viewer.setOverlay({boxes: this.boxes.checked}));
    const boxes = createElement("label", {class: "row check"}, this.boxes, "Show the ranks' boxes in the picture");
    const parts = [this.total, this.bars, this.legend, this.table, boxes];
    this.element = createElement("div", {class: "statistics"}, ...parts);
    viewer.on("statistics", (message) => this.showStatistics(message));
    viewer.on("overlay", () => (this.boxes.checked = Boolean(viewer.overlay.boxes)));
    if (viewer.statistics) this.showStatistics(viewer.statistics);
  }

  show() {
    this.boxes.checked = Boolean(this.viewer.overlay.boxes);
  }

  showStatistics({total_seconds: total, stages, per_rank: ranks, imbalance}) {
    const balance = ranks.length > 1 ? ` · imbalance ${imbalance?.toFixed(2) ?? "–"}` : "";
    this.total.textContent = `Frame: ${formatSeconds(total)}${balance}`;
    const parts = ranks.map((rank) => stageParts(rank, stages, total));
    const scale = Math.max(total, ...parts.map((each) => each.reduce((sum, part) => sum + part.seconds, 0)));
    this.bars.replaceChildren(...parts.map((each, rank) => bar(rank, each, scale)));
    this.showLegend([...stages, "other"], parts, total);
    this.showTable(ranks);
  }

  /** The stages that take some of the time, with the time of the slowest rank. */
  showLegend(stages, parts, total) {
    const secondsOf = (each, stage) => each.find((part) => part.stage === stage)?.seconds ?? 0;
    const longest = (stage) => Math.max(...parts.map((each) => secondsOf(each, stage)));
    const shown = stages.map((stage) => [stage, longest(stage)]).filter(([, seconds]) => seconds > LEAST_SHARE * total);
    this.legend.replaceChildren(...shown.map(([stage, seconds]) => legendItem(stage, seconds)));
  }

  showTable(ranks) {
    const head = ["rank", "samples", "bricks", "sent", "memory"].map((title) => createElement("th", {}, title));
    const rows = ranks.map((rank, number) => {
      const sample = createElement("span", {class: "swatch"});
      sample.style.background = rankColour(number);
      const texts = [formatCount(rank.samples), formatCount(rank.bricks_drawn), formatBytes(rank.bytes_sent)];
      const cells = [...texts, formatBytes(rank.peak_memory_bytes)].map((text) => createElement("td", {}, text));
      return createElement("tr", {}, createElement("th", {}, sample, String(number)), ...cells);
    });
    const titles = createElement("thead", {}, createElement("tr", {}, ...head));
    this.table.replaceChildren(titles, createElement("tbody", {}, ...rows));
  }
}

function stageColour(stage) {
  return STAGE_COLOURS[stage] ?? STAGE_COLOURS.other;
}

function bar(rank, parts, scale) {
  const track = createElement("div", {class: "track"}, ...parts.map((part) => segment(part, scale)));
  const sum = parts.reduce((seconds, part) => seconds + part.seconds, 0);
  const label = createElement("span", {class: "bar-label"}, `rank ${rank}`);
  return createElement("div", {class: "bar", "data-rank": rank, "data-seconds": sum}, label, track);
}

function segment({stage, seconds}, scale) {
  const title = `${stage}: ${formatSeconds(seconds)}`;
  const part = createElement("span", {title, "data-stage": stage, "data-seconds": seconds});
  part.style.width = `${(100 * seconds) / scale}%`;
  part.style.background = stageColour(stage);
  return part;
}

function legendItem(stage, seconds) {
  const sample = createElement("span", {class: "swatch"});
  sample.style.background = stageColour(stage);
  return createElement("span", {class: "legend-item"}, sample, `${stage} ${formatSeconds(seconds)}`);
}
