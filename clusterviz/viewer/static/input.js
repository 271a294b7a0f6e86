/**
 * Mouse, touch and keyboard become cameras.
 *
 * @typedef {object} Controls what the input acts on
 * @property {() => import("./camera.js").Camera} camera
 * @property {(camera: import("./camera.js").Camera) => void} move the camera while something moves
 * @property {() => void} flush send the camera now, not in the next animation frame
 * @property {() => void} settle the camera stands still
 * @property {() => boolean} allowed whether this client may move the camera; tells the user if not
 * @property {() => number} radius of what is shown, world units
 * @property {(x: number, y: number) => ?{drag: (x: number, y: number) => void, drop: () => void}} grab
 *   a handle of the overlay at a point, CSS pixels
 * @property {(x: number, y: number) => void} hover
 * @property {(x: number, y: number, centre: boolean) => void} pick
 * @property {Record<string, () => void>} actions by name, see KEY_ACTIONS
 */
import {eyeDistance, look, orbit, pan, roll, travel, zoom} from "./camera.js";

/** Degrees of an orbit over the shorter side of the view, as in VTK. */
const DEGREES_PER_SIDE = 200;
const CLICK_PIXELS = 4;
/** Largest time and distance between the clicks of a double click, or of a double tap. */
const DOUBLE_MILLISECONDS = 350;
const DOUBLE_PIXELS = 20;
/** Nearest and farthest eye that zooming reaches, radii of the scene. */
const ZOOM_RADII = [1e-5, 1e5];
/** Time after the last key press or turn of the wheel at which the camera stands still, milliseconds. */
const SETTLE_MILLISECONDS = 200;
const KEY_DEGREES = 5;
const KEY_PAN = 0.04;
const KEY_ZOOM = 1.1;
/** Speed of flight, radii of the scene a second. */
const FLY_RADII = 0.6;
const FLY_FASTER = 4;
const FLY_KEYS = {w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, 1, 0], q: [0, -1, 0]};
const ARROWS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
const KEY_ACTIONS = {
  r: "fit", R: "reset", f: "fly", p: "pick", o: "projection", b: "sidebar", " ": "play", "?": "help",
  1: "front", 2: "back", 3: "left", 4: "right", 5: "top", 6: "bottom",
  x: "right", X: "left", y: "back", Y: "front", z: "top", Z: "bottom",
};

/** What mouse, fingers and keys do: the table of the help dialog. */
export const INPUT_HELP = [
  ["Orbit", "Drag · one finger · arrow keys"],
  ["Pan", "Shift or middle drag · two fingers · Shift + arrow keys"],
  ["Zoom", "Wheel, right drag · pinch · + and −"],
  ["Roll", "Ctrl + drag · twist two fingers"],
  ["Pick position and value", "Click · P at the cursor"],
  ["Centre on a point", "Double click · double tap"],
  ["Fit everything", "R"],
  ["Views along the axes", "1 … 6 · X, Y, Z, with Shift from the other side"],
  ["Parallel or perspective", "O"],
  ["Fly", "F, then W A S D, Q E, Shift faster; drag to look around"],
  ["Play the camera path", "Space"],
  ["Side bar", "B"],
  ["Undo, redo", "Ctrl + Z, Ctrl + Y"],
  ["Scene as it was opened", "Shift + R"],
  ["This help", "?"],
];

/** Listens to an element and moves the camera. */
export class ViewInput {
  /** @param {HTMLElement} root keys @param {HTMLElement} surface mouse and touch @param {Controls} controls */
  constructor(root, surface, controls) {
    this.root = root;
    this.surface = surface;
    this.controls = controls;
    this.flying = false;
    /** @type {Map<number, {x: number, y: number}>} */
    this.pointers = new Map();
    this.cursor = {x: 0, y: 0};
    this.clicked = {x: 0, y: 0, time: -Infinity};
    this.gesture = null;
    this.heldKeys = new Set();
    this.settleTimer = 0;
    this.flight = 0;
    const on = (element, name, f, options) => element.addEventListener(name, f.bind(this), options);
    on(surface, "pointerdown", this.pressed);
    on(surface, "pointermove", this.dragged);
    on(surface, "pointerup", this.released);
    on(surface, "pointercancel", this.released);
    on(surface, "wheel", this.wheeled, {passive: false});
    on(surface, "contextmenu", (event) => event.preventDefault());
    on(root, "keydown", this.keyPressed);
    on(root, "keyup", this.keyReleased);
    on(surface, "blur", this.stopFlight);
  }

  destroy() {
    clearTimeout(this.settleTimer);
    cancelAnimationFrame(this.flight);
  }

  /** @returns {boolean} whether a drag or a flight is under way */
  get active() {
    return this.gesture !== null || this.heldKeys.size > 0;
  }

  position(event) {
    const {left, top} = this.surface.getBoundingClientRect();
    return {x: event.clientX - left, y: event.clientY - top};
  }

  pressed(event) {
    this.root.classList.remove("keyboard");
    this.surface.focus({preventScroll: true});
    this.surface.setPointerCapture(event.pointerId);
    const point = this.position(event);
    this.pointers.set(event.pointerId, point);
    if (this.gesture?.handle) return;
    const first = this.pointers.size === 1 && event.button === 0;
    const handle = first ? this.controls.grab(point.x, point.y) : null;
    const moved = this.gesture?.moved ?? false;
    this.gesture = {name: this.gestureName(event), handle, start: point, moved, clicks: first && !handle};
  }

  gestureName(event) {
    if (this.pointers.size > 1) return "pinch";
    if (event.button === 1 || (event.button === 0 && event.shiftKey)) return "pan";
    if (event.button === 2) return "zoom";
    if (event.ctrlKey || event.metaKey) return "roll";
    return this.flying ? "look" : "orbit";
  }

  dragged(event) {
    const point = this.position(event);
    this.cursor = point;
    const before = this.pointers.get(event.pointerId);
    if (!this.gesture || !before) {
      this.controls.hover(point.x, point.y);
      return;
    }
    const {start, handle} = this.gesture;
    if (!this.gesture.moved && Math.hypot(point.x - start.x, point.y - start.y) < CLICK_PIXELS) return;
    if (!this.gesture.moved && !this.controls.allowed()) {
      this.cancelGesture();
      return;
    }
    this.gesture.moved = true;
    if (handle) handle.drag(point.x, point.y);
    else this.controls.move(this.draggedCamera(event.pointerId, before, point));
    this.pointers.set(event.pointerId, point);
  }

  draggedCamera(pointer, before, point) {
    const camera = this.controls.camera();
    const {clientWidth: width, clientHeight: height} = this.surface;
    const [dx, dy] = [point.x - before.x, point.y - before.y];
    const degrees = DEGREES_PER_SIDE / Math.min(width, height);
    switch (this.gesture.name) {
      case "pan": return pan(camera, dx / height, dy / height);
      case "zoom": return this.zoomed(camera, Math.exp((-3 * dy) / height), this.gesture.start);
      case "roll": return roll(camera, angleAbout(width / 2, height / 2, before, point));
      case "look": return look(camera, (dx * camera.view_angle) / height, (-dy * camera.view_angle) / height);
      case "pinch": return this.pinched(camera, pointer, before, point);
      default: return orbit(camera, -dx * degrees, dy * degrees);
    }
  }

  /** Two fingers: their centre pans, their distance zooms, their angle rolls. */
  pinched(camera, pointer, before, point) {
    const other = [...this.pointers].find(([id]) => id !== pointer)?.[1];
    if (!other) return camera;
    const height = this.surface.clientHeight;
    const moved = pan(camera, (point.x - before.x) / 2 / height, (point.y - before.y) / 2 / height);
    const spread = (each) => Math.max(1, Math.hypot(each.x - other.x, each.y - other.y));
    const centre = {x: (point.x + other.x) / 2, y: (point.y + other.y) / 2};
    const nearer = this.zoomed(moved, spread(point) / spread(before), centre);
    return roll(nearer, angleAbout(other.x, other.y, before, point));
  }

  /** Magnify about a point in CSS pixels, within limits. */
  zoomed(camera, factor, point) {
    const size = (camera.parallel_scale ?? eyeDistance(camera)) / factor;
    const [nearest, farthest] = ZOOM_RADII.map((radii) => radii * this.controls.radius());
    if (factor > 1 ? size < nearest : size > farthest) return camera;
    return zoom(camera, factor, ...this.fromCentre(point));
  }

  /** From the centre of the view to the right and down, as shares of its height. */
  fromCentre(point) {
    const {clientWidth: width, clientHeight: height} = this.surface;
    return [(point.x - width / 2) / height, (point.y - height / 2) / height];
  }

  centre() {
    return {x: this.surface.clientWidth / 2, y: this.surface.clientHeight / 2};
  }

  released(event) {
    const point = this.pointers.get(event.pointerId);
    this.pointers.delete(event.pointerId);
    if (!this.gesture || !point) return;
    const {handle, moved, clicks} = this.gesture;
    if (this.pointers.size > 0) {
      this.gesture = {...this.gesture, name: this.flying ? "look" : "orbit"};
      return;
    }
    this.gesture = null;
    if (handle) handle.drop();
    else if (moved) this.controls.settle();
    else if (clicks && event.type === "pointerup") this.click(point, event.timeStamp);
  }

  /** A click picks; a second one beside it centres. */
  click({x, y}, time) {
    const near = Math.hypot(x - this.clicked.x, y - this.clicked.y) < DOUBLE_PIXELS;
    const isDouble = near && time - this.clicked.time < DOUBLE_MILLISECONDS;
    this.clicked = {x, y, time: isDouble ? -Infinity : time};
    this.controls.pick(x, y, isDouble);
  }

  cancelGesture() {
    this.pointers.clear();
    this.gesture = null;
  }

  wheeled(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 33 : 1;
    const factor = Math.exp(-0.0015 * Math.max(-300, Math.min(300, event.deltaY * lines)));
    this.step((camera) => this.zoomed(camera, factor, this.position(event)));
  }

  /** Move the camera by one step of the wheel or of a key; it stands still soon after the last one. */
  step(change) {
    if (!this.controls.allowed()) return;
    this.controls.move(change(this.controls.camera()));
    clearTimeout(this.settleTimer);
    this.settleTimer = setTimeout(() => this.active || this.controls.settle(), SETTLE_MILLISECONDS);
  }

  keyPressed(event) {
    this.faster = event.shiftKey;
    if (isEditable(event.target) || event.altKey || !this.handleKey(event)) return;
    event.preventDefault();
    event.stopPropagation();
  }

  /** @returns {boolean} whether the key means something */
  handleKey(event) {
    const {key} = event;
    const {actions} = this.controls;
    if (event.ctrlKey || event.metaKey) {
      const action = {z: event.shiftKey ? "redo" : "undo", Z: "redo", y: "redo"}[key];
      if (action) actions[action]();
      return Boolean(action);
    }
    if (key === "Tab") this.root.classList.add("keyboard");
    if (key === "?") actions.help();
    if (key === "?" || ![this.surface, this.root].includes(event.target)) return key === "?";
    if (this.flying && key.toLowerCase() in FLY_KEYS) this.startFlight(key.toLowerCase());
    else if (key in ARROWS) this.step((camera) => arrowStep(camera, ARROWS[key], event.shiftKey));
    else if ("+=".includes(key)) this.step((camera) => this.zoomed(camera, KEY_ZOOM, this.centre()));
    else if ("-_".includes(key)) this.step((camera) => this.zoomed(camera, 1 / KEY_ZOOM, this.centre()));
    else if (key in KEY_ACTIONS && !event.repeat) actions[KEY_ACTIONS[key]]();
    else return false;
    return true;
  }

  keyReleased(event) {
    this.faster = event.shiftKey;
    if (!this.heldKeys.delete(event.key.toLowerCase()) || this.heldKeys.size > 0) return;
    this.controls.settle();
  }

  startFlight(key) {
    if (this.heldKeys.has(key) || !this.controls.allowed()) return;
    this.heldKeys.add(key);
    if (this.heldKeys.size > 1) return;
    let before = performance.now();
    const fly = (now) => {
      if (this.heldKeys.size === 0) return;
      const speed = this.controls.radius() * FLY_RADII * (this.faster ? FLY_FASTER : 1);
      const distance = (speed * Math.max(0, now - before)) / 1000;
      before = now;
      const sum = [...this.heldKeys].map((held) => FLY_KEYS[held]).reduce((a, b) => a.map((v, i) => v + b[i]));
      this.controls.move(travel(this.controls.camera(), ...sum.map((v) => v * distance)));
      this.controls.flush();
      this.flight = requestAnimationFrame(fly);
    };
    this.flight = requestAnimationFrame(fly);
  }

  stopFlight() {
    if (this.heldKeys.size === 0) return;
    this.heldKeys.clear();
    this.controls.settle();
  }
}

function arrowStep(camera, [dx, dy], pans) {
  if (pans) return pan(camera, -dx * KEY_PAN, dy * KEY_PAN);
  return orbit(camera, dx * KEY_DEGREES, dy * KEY_DEGREES);
}

/** Degrees, counterclockwise on the screen: a camera that rolls clockwise by them turns the scene with the pointer. */
function angleAbout(x, y, before, after) {
  const turn = Math.atan2(after.y - y, after.x - x) - Math.atan2(before.y - y, before.x - x);
  const wrapped = Math.atan2(Math.sin(turn), Math.cos(turn));
  return (-wrapped * 180) / Math.PI;
}

function isEditable(element) {
  const text = "input:not([type=range], [type=checkbox], [type=radio])";
  return element.closest(`${text}, textarea, select, [contenteditable], dialog`);
}
