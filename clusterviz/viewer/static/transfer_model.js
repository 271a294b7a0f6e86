// Transfer function of one content while it is edited: rows of its handles, without elements.

/**
 * A handle of the plot: a control point of opacity ("point") or colour ("colour"), an isovalue ("surface"), or an end
 * of the colour limits ("limit").
 * @typedef {{kind: "point"|"surface"|"limit"|"colour", index: number}} Handle
 */

const MOST_STOPS = 64;
/** Control points that a named colour map becomes when its colours are edited. */
const EDITED_COLOURS = 8;

/** Entry of `state.volumes`, `state.geometry`, `state.grids` or `state.flows` for the section at a path such as "volumes.0". */
export function contentEntry(state, path) {
  const each = [...(state.volumes ?? []), ...(state.geometry ?? []), ...(state.grids ?? []), ...(state.flows ?? [])];
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

/** A column of control points [value, …] at a value; null without points. */
export function columnAt(points, value, column = 1) {
  if (!points.length) return null;
  const right = points.findIndex((point) => point[0] > value);
  if (right === 0) return points[0][column];
  if (right < 0) return points[points.length - 1][column];
  const [a, b] = [points[right - 1], points[right]];
  return a[column] + ((value - a[0]) / (b[0] - a[0])) * (b[column] - a[column]);
}

/** At most so many rows, at equal distances and with both ends. */
function thinned(rows, most) {
  if (rows.length <= most) return rows;
  return Array.from({length: most}, (_, at) => rows[Math.round((at * (rows.length - 1)) / (most - 1))]);
}

/** Whether colours are control points with values, which do not follow the colour limits. */
export function hasColourPoints(cmap) {
  return Array.isArray(cmap) && cmap[0].length === 4;
}

export class TransferModel {
  constructor() {
    /** @type {[number, number][]} value, opacity */
    this.points = [];
    /** Name of the preset that gives the points, or null. */
    this.preset = null;
    /** @type {?[number, ?number][]} value, opacity or null for that of the points; null where there are none */
    this.surfaces = null;
    /** @type {?[number, number]} */
    this.limits = null;
    /** @type {?number[][]} value, r, g, b; null where the colours are not control points */
    this.colours = null;
    /** Colours of the last state, with its limits. */
    this.stops = [];
    this.stopLimits = null;
  }

  takeOpacity(value, entry, limits) {
    const constant = typeof value === "number" ? [[limits?.[0] ?? entry.minimum ?? 0, value]] : null;
    this.points = (Array.isArray(value) ? value : (constant ?? entry.opacity_points ?? [])).map((row) => [...row]);
    this.preset = typeof value === "string" ? value : null;
  }

  takeSurfaces(value) {
    this.surfaces = value ? value.map((surface) => (Array.isArray(surface) ? [...surface] : [surface, null])) : null;
  }

  takeColours(cmap, entry, limits) {
    this.colours = hasColourPoints(cmap) ? cmap.map((row) => [...row]) : null;
    this.stops = thinned(entry.colour_points ?? [], MOST_STOPS);
    this.stopLimits = limits;
  }

  /** Rows [value, r, g, b] of the colours, for the present limits. */
  colourRows() {
    if (this.colours) return this.colours;
    if (!this.limits || !this.stopLimits) return this.stops;
    const [[a, b], [low, high]] = [this.stopLimits, this.limits];
    if (b <= a) return this.stops;
    return this.stops.map(([value, ...rgb]) => [low + ((value - a) / (b - a)) * (high - low), ...rgb]);
  }

  /** Make control points of a named colour map. @param {(value: number) => number} rounded */
  editColours(rounded) {
    const short = ([value, ...rgb]) => [rounded(value), ...rgb.map((part) => Number(part.toFixed(4)))];
    this.colours ??= thinned(this.colourRows(), EDITED_COLOURS).map(short);
  }

  /** Opacity of an isosurface, its own or that of the points. */
  surfaceOpacity([value, opacity]) {
    return opacity ?? columnAt(this.points, value) ?? 1;
  }

  /** Rows of a kind of handles; those of limits hold one number. */
  rows(kind) {
    if (kind === "limit") return (this.limits ?? []).map((value) => [value]);
    return {point: this.points, surface: this.surfaces ?? [], colour: this.colours ?? []}[kind];
  }

  /** The row of a handle; null if there is none. */
  row(handle) {
    return handle ? (this.rows(handle.kind)[handle.index] ?? null) : null;
  }

  setRows(kind, rows) {
    if (kind === "point") [this.points, this.preset] = [rows, null];
    if (kind === "surface") this.surfaces = rows;
    if (kind === "limit") this.limits = rows.map(([value]) => value);
    if (kind === "colour") this.colours = rows;
  }

  /** A kind's value in the scene. */
  sceneValue(kind) {
    if (kind === "surface") return this.surfaces.map((row) => (row[1] == null ? row[0] : row));
    return kind === "limit" ? this.limits : this.rows(kind);
  }

  /** All handles, with value and opacity. */
  handles() {
    const each = ["limit", "colour", "surface", "point"].flatMap((kind) =>
      this.rows(kind).map((row, index) => ({kind, index, value: row[0], row})),
    );
    const opacities = {point: (row) => row[1], surface: (row) => this.surfaceOpacity(row)};
    return each.map(({row, ...handle}) => ({...handle, opacity: opacities[handle.kind]?.(row) ?? null}));
  }

  /** Smallest and largest value of all that is shown. @returns {[number, number]} */
  range(entry) {
    const values = [entry.minimum, entry.maximum, ...(this.limits ?? []), ...this.points.map((point) => point[0])];
    const known = values.filter((value) => Number.isFinite(value));
    return known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
  }
}
