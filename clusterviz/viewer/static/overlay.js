/**
 * Lines and handles over the picture: boxes of ranks, clip box and planes, the picked point, axes. They are drawn with
 * the camera of the shown picture, so that they are where the picture has them.
 */
import {
  addScaled, boxCorners, boundingSphere, cameraAxes, cross, directionOnSphere, dot, nearestOnAxis, normalized,
  pixelRay, projected, subtract,
} from "./camera.js";

/** Okabe and Ito's colours, which people with colour blindness tell apart. */
const RANK_COLOURS = ["#56b4e9", "#e69f00", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7", "#999999"];
const CLIP_COLOURS = {line: "#ffffff", halo: "rgb(0 0 0 / 55%)", handle: "#ff5da2", hovered: "#ffffff"};
const AXIS_COLOURS = ["#e5484d", "#46a758", "#3e8ef7"];
const HANDLE_PIXELS = 7;
/** Distance at which a handle is grabbed, CSS pixels: wide enough for a finger. */
const GRAB_PIXELS = 16;
const AXES_PIXELS = 30;
/** Half the side of a clip plane's square, and the length of its arrow, in radii of what is shown. */
const PLANE_RADII = 0.75;
const ARROW_RADII = 0.35;
const SQUARE = [[1, 1], [-1, 1], [-1, -1], [1, -1]];

/** @type {(rank: number) => string} CSS colour of a rank, the same in the scene and in the panels */
export function rankColour(rank) {
  return RANK_COLOURS[rank % RANK_COLOURS.length];
}

/**
 * @typedef {object} OverlayView what the overlay draws; read at each drawing
 * @property {?object} state the session's newest state
 * @property {?object} statistics the newest statistics
 * @property {?import("./picture.js").PictureHeader} picture
 * @property {Record<string, boolean>} overlay what is switched on: axes, boxes, clip, pick
 * @property {?{position: number[], text: string}} picked
 * @property {boolean} steers whether handles can be dragged
 */

export class Overlay {
  /** @param {HTMLCanvasElement} canvas @param {OverlayView} view
   * @param {() => import("./picture.js").Rectangle} rectangle that the picture fills, device pixels
   * @param {(changes: object, options: {moving: boolean, merge: string}) => void} edit */
  constructor(canvas, view, rectangle, edit) {
    this.canvas = canvas;
    this.view = view;
    this.rectangle = rectangle;
    this.edit = edit;
    /** Clip as dragged, ahead of the session's state. @type {?{box: ?number[], planes: number[][][]}} */
    this.dragged = null;
    this.dragging = false;
    this.drags = 0;
    this.hovered = null;
  }

  /** Draw everything that is switched on. */
  draw() {
    const context = this.canvas.getContext("2d");
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const {picture, overlay, picked} = this.view;
    if (!picture || !this.view.state) return;
    this.unit = this.canvas.width / this.canvas.clientWidth || 1;
    context.lineWidth = 1.5 * this.unit;
    context.font = `${12 * this.unit}px system-ui, sans-serif`;
    if (overlay.boxes) this.drawRanks(context);
    if (overlay.clip) this.drawClip(context);
    if (overlay.pick && picked) this.drawPicked(context, picked);
    if (overlay.axes) this.drawAxes(context);
  }

  /** The session has sent a new state: it replaces what was dragged. */
  stateChanged() {
    if (!this.dragging) this.dragged = null;
    this.draw();
  }

  // Projection ---------------------------------------------------------------------------------------------------

  /** World to device pixels of the canvas, and depth. */
  project(point) {
    const {width, height, camera} = this.view.picture;
    const area = this.rectangle();
    const [x, y, ahead] = projected(camera, point, width, height);
    return [area.left + (x * area.width) / width, area.top + (y * area.height) / height, ahead];
  }

  /** Ray through a point in CSS pixels. */
  ray(x, y) {
    const {width, height, camera} = this.view.picture;
    const area = this.rectangle();
    const column = ((x * this.unit - area.left) * width) / area.width;
    const row = ((y * this.unit - area.top) * height) / area.height;
    return pixelRay(camera, column, row, width, height);
  }

  /** Draw a line between world points, if both are in front of the eye. */
  line(context, from, to) {
    const [a, b] = [this.project(from), this.project(to)];
    if (a[2] <= 0 || b[2] <= 0) return;
    context.beginPath();
    context.moveTo(a[0], a[1]);
    context.lineTo(b[0], b[1]);
    context.stroke();
  }

  /** Edges between corners in binary order: indices that differ in one bit. */
  boxEdges(context, corners) {
    for (let i = 0; i < 8; i += 1) {
      for (const bit of [1, 2, 4]) if (!(i & bit)) this.line(context, corners[i], corners[i | bit]);
    }
  }

  // What is drawn ------------------------------------------------------------------------------------------------

  drawRanks(context) {
    for (const {rank, corners} of this.view.statistics?.boxes ?? []) {
      context.strokeStyle = rankColour(rank);
      this.boxEdges(context, corners);
    }
  }

  drawClip(context) {
    const {box, planes} = this.clip();
    for (const [style, width] of [[CLIP_COLOURS.halo, 4], [CLIP_COLOURS.line, 1.5]]) {
      context.strokeStyle = style;
      context.lineWidth = width * this.unit;
      if (box) this.boxEdges(context, boxCorners(boxBounds(box)));
      planes.forEach((plane) => this.drawPlane(context, plane));
    }
    if (this.view.steers) for (const handle of this.handles()) this.drawHandle(context, handle);
  }

  drawPlane(context, plane) {
    const {centre, normal, half} = this.planeFrame(plane);
    const [across, along] = perpendicular(normal);
    const corners = SQUARE.map(([a, b]) => addScaled(addScaled(centre, across, a * half), along, b * half));
    corners.forEach((corner, i) => this.line(context, corner, corners[(i + 1) % 4]));
    this.line(context, centre, this.arrowTip(plane));
  }

  drawHandle(context, {name, point, round}) {
    const [x, y, ahead] = this.project(point);
    if (ahead <= 0) return;
    const radius = HANDLE_PIXELS * this.unit * (this.hovered === name ? 1.35 : 1);
    context.beginPath();
    if (round) context.arc(x, y, radius, 0, 2 * Math.PI);
    else context.rect(x - radius * 0.85, y - radius * 0.85, radius * 1.7, radius * 1.7);
    context.fillStyle = this.hovered === name ? CLIP_COLOURS.hovered : CLIP_COLOURS.handle;
    context.fill();
    context.strokeStyle = "#000000";
    context.stroke();
  }

  drawPicked(context, {position, text}) {
    const [x, y, ahead] = this.project(position);
    if (ahead <= 0) return;
    const arm = 9 * this.unit;
    for (const [style, width] of [["#000000", 4], ["#ffffff", 1.75]]) {
      context.strokeStyle = style;
      context.lineWidth = width * this.unit;
      context.beginPath();
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        context.moveTo(x + (dx * arm) / 3, y + (dy * arm) / 3);
        context.lineTo(x + dx * arm, y + dy * arm);
      }
      context.stroke();
    }
    this.drawLabel(context, text, x + 14 * this.unit, y - 14 * this.unit);
  }

  drawLabel(context, text, x, y) {
    const lines = text.split("\n");
    const pad = 6 * this.unit;
    const lineHeight = 16 * this.unit;
    const width = Math.max(...lines.map((line) => context.measureText(line).width)) + 2 * pad;
    const height = lines.length * lineHeight + pad;
    const left = Math.max(0, Math.min(x, this.canvas.width - width));
    const top = Math.max(0, Math.min(y - height, this.canvas.height - height));
    context.fillStyle = "rgb(20 22 26 / 85%)";
    context.beginPath();
    context.roundRect(left, top, width, height, 4 * this.unit);
    context.fill();
    context.fillStyle = "#ffffff";
    context.textBaseline = "middle";
    lines.forEach((line, i) => context.fillText(line, left + pad, top + pad / 2 + (i + 0.5) * lineHeight));
  }

  /** Axes of the world in the lower left corner: the nearest last, so that it is in front. */
  drawAxes(context) {
    const {right, up, forward} = cameraAxes(this.view.picture.camera);
    const length = AXES_PIXELS * this.unit;
    const [x, y] = [1.9 * length, this.canvas.height - 2.6 * length];
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineWidth = 2.25 * this.unit;
    for (const axis of [0, 1, 2].sort((a, b) => forward[b] - forward[a])) {
      const tip = [x + right[axis] * length, y - up[axis] * length];
      const label = [x + right[axis] * length * 1.25, y - up[axis] * length * 1.25];
      context.strokeStyle = context.fillStyle = AXIS_COLOURS[axis];
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(...tip);
      context.stroke();
      context.beginPath();
      context.arc(...label, 7.5 * this.unit, 0, 2 * Math.PI);
      context.fill();
      context.fillStyle = "#ffffff";
      context.fillText(this.axisName(axis), ...label);
    }
    context.textAlign = "start";
  }

  axisName(axis) {
    return this.view.state.volumes?.[0]?.orientation?.[axis] || "XYZ"[axis];
  }

  // Clip box and planes ------------------------------------------------------------------------------------------

  clip() {
    const clip = this.view.state.scene.clip ?? {};
    return this.dragged ?? {box: clip.box ?? null, planes: clip.planes ?? []};
  }

  /** Where a plane is drawn: the point of it that is nearest to the centre of what is shown. */
  planeFrame([point, direction]) {
    const {centre, radius} = boundingSphere(this.view.state.bounds);
    const normal = normalized(direction);
    const nearest = addScaled(centre, normal, dot(subtract(point, centre), normal));
    return {centre: nearest, normal, half: PLANE_RADII * radius};
  }

  arrowTip(plane) {
    const {centre, normal, half} = this.planeFrame(plane);
    return addScaled(centre, normal, (half / PLANE_RADII) * ARROW_RADII);
  }

  /** @returns {{name: string, point: number[], round: boolean, drag: (ray: object) => ?object}[]}
   * drag: the clip that follows when the handle is dragged to a ray */
  handles() {
    const {box, planes} = this.clip();
    const found = box ? [0, 1, 2, 3, 4, 5].map((face) => this.faceHandle(box, face)) : [];
    planes.forEach((plane, i) => found.push(this.moveHandle(plane, i), this.turnHandle(plane, i)));
    return found;
  }

  faceHandle(box, face) {
    const bounds = boxBounds(box);
    const axis = face >> 1;
    const point = addScaled([0, 0, 0], addScaled(bounds[0], bounds[1]), 0.5);
    point[axis] = box[face];
    const unit = [0, 1, 2].map((k) => (k === axis ? 1 : 0));
    const drag = (ray, clip) => {
      const along = nearestOnAxis(ray, point, unit);
      if (along === null) return null;
      const changed = [...clip.box];
      changed[face] = this.withinBounds(clip.box, face, point[axis] + along);
      return {...clip, box: changed};
    };
    return {name: `box ${face}`, point, round: true, drag};
  }

  /** A face of the clip box stays inside the bounds of what is shown, and on its side of the opposite face. */
  withinBounds(box, face, value) {
    const axis = face >> 1;
    const [low, high] = [this.view.state.bounds[0][axis], this.view.state.bounds[1][axis]];
    const least = (high - low) * 1e-3;
    if (face % 2 === 0) return Math.min(Math.max(value, Math.min(low, box[face])), box[face + 1] - least);
    return Math.max(Math.min(value, Math.max(high, box[face])), box[face - 1] + least);
  }

  moveHandle(plane, index) {
    const {centre, normal} = this.planeFrame(plane);
    const drag = (ray, clip) => {
      const along = nearestOnAxis(ray, centre, normal);
      return along === null ? null : withPlane(clip, index, [addScaled(centre, normal, along), plane[1]]);
    };
    return {name: `move ${index}`, point: centre, round: false, drag};
  }

  turnHandle(plane, index) {
    const {centre, half} = this.planeFrame(plane);
    const radius = (half / PLANE_RADII) * ARROW_RADII;
    const drag = (ray, clip) => withPlane(clip, index, [centre, directionOnSphere(ray, centre, radius)]);
    return {name: `turn ${index}`, point: this.arrowTip(plane), round: true, drag};
  }

  /** @returns {?object} the handle at a point, CSS pixels */
  handleAt(x, y) {
    if (!this.view.steers || !this.view.overlay.clip || !this.view.picture || !this.unit) return null;
    const distances = this.handles().map((handle) => {
      const [column, row, ahead] = this.project(handle.point);
      return {handle, distance: ahead > 0 ? Math.hypot(column / this.unit - x, row / this.unit - y) : Infinity};
    });
    const nearest = distances.sort((a, b) => a.distance - b.distance)[0];
    return nearest && nearest.distance <= GRAB_PIXELS ? nearest.handle : null;
  }

  hover(x, y) {
    const name = this.handleAt(x, y)?.name ?? null;
    this.canvas.classList.toggle("over-handle", name !== null);
    if (name === this.hovered) return;
    this.hovered = name;
    this.draw();
  }

  /** Start to drag the handle at a point. @returns {?{drag: (x: number, y: number) => void, drop: () => void}} */
  grab(x, y) {
    const handle = this.handleAt(x, y);
    if (!handle) return null;
    const before = this.clip();
    const key = handle.name.startsWith("box") ? "box" : "planes";
    this.drags += 1;
    const merge = `clip ${this.drags}`;
    this.dragging = true;
    const send = (moving) => this.edit({[`clip.${key}`]: this.clip()[key]}, {moving, merge});
    return {
      drag: (column, row) => {
        this.dragged = handle.drag(this.ray(column, row), before) ?? this.dragged;
        this.draw();
        send(true);
      },
      drop: () => {
        this.dragging = false;
        if (this.dragged) send(false);
      },
    };
  }
}

function boxBounds([x0, x1, y0, y1, z0, z1]) {
  return [[x0, y0, z0], [x1, y1, z1]];
}

function withPlane(clip, index, plane) {
  return {...clip, planes: clip.planes.map((each, i) => (i === index ? plane : each))};
}

/** Two unit vectors across a direction. */
function perpendicular(direction) {
  const smallest = direction.map(Math.abs).indexOf(Math.min(...direction.map(Math.abs)));
  const across = normalized(cross(direction, [0, 1, 2].map((k) => (k === smallest ? 1 : 0))));
  return [across, cross(direction, across)];
}
