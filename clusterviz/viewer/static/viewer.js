/**
 * The view of one session: the picture, its camera, and what the session has told.
 *
 * Panels build on what `createViewer` returns: they read `hello`, `state`, `picture`, `camera` and `statistics`, change
 * the scene by `edit`, and hear of news by `on`.
 */
import {
  boundingSphere, boxCorners, centred, fitted, interpolateCamera, namedView, otherProjection,
} from "./camera.js";
import {createElement} from "./elements.js";
import {ViewInput} from "./input.js";
import {Banner, Toasts, createHelp, showSteering} from "./notices.js";
import {Overlay} from "./overlay.js";
import {createPanels} from "./panels.js";
import {cameraOnPath} from "./path.js";
import {PictureCanvas, parseBinary} from "./picture.js";
import {StatusLine} from "./status.js";
import {createToolbar} from "./toolbar.js";

/** Duration of an animation to a view, seconds. */
const ANIMATION_SECONDS = 0.4;
const RESIZE_MILLISECONDS = 150;
const MAX_SIDE = 4096;
const VIEWS = ["front", "back", "left", "right", "top", "bottom"];

/** @type {(parent: HTMLElement, connection: import("./connection.js").Connection) => Viewer} */
export function createViewer(parent, connection) {
  return new Viewer(parent, connection);
}

/**
 * Events, for `on`: every type of message of the session, with the message; "picture" (its header, when shown), "file"
 * ({header, payload}), "camera" (the camera), "overlay" (what is switched on), "connection" (its status).
 */
export class Viewer {
  constructor(parent, connection) {
    this.connection = connection;
    /** @type {?object} newest messages of the session, null before the first */
    this.hello = null;
    this.state = null;
    this.statistics = null;
    /** @type {?import("./camera.js").Camera} newest camera, ahead of the picture's while moving */
    this.camera = null;
    /** What is drawn over the picture. */
    this.overlay = {axes: true, boxes: false, clip: true, pick: true};
    /** @type {?{position: number[], text: string}} */
    this.picked = null;
    this.listeners = new Map();
    this.input = 0;
    this.sentTimes = new Map();
    /** @type {?{width: number, height: number}} of the canvas, device pixels */
    this.size = null;
    this.picks = 0;
    /** @type {?{camera: object, moving: boolean, input: number}} messages for the next frame */
    this.pendingView = null;
    this.pendingEdit = null;
    this.frame = 0;
    this.animation = 0;
    this.path = [];
    this.build(parent);
    this.listen();
  }

  // The page -----------------------------------------------------------------------------------------------------

  build(parent) {
    const picture = createElement("canvas", {class: "picture"});
    this.surface = createElement("canvas", {
      class: "overlay", tabindex: "0", role: "application",
      "aria-label": "Picture. Arrow keys orbit, plus and minus zoom, question mark shows all keys.",
    });
    const acknowledge = (header) => this.send({type: "ack", picture: header.picture});
    this.pictureCanvas = new PictureCanvas(picture, (header) => this.pictureShown(header), acknowledge);
    this.overlayCanvas = new Overlay(
      this.surface, this, () => this.pictureCanvas.rectangle(), (changes, options) => this.edit(changes, options),
    );
    this.toasts = new Toasts();
    this.connectionBanner = new Banner("lost");
    this.steeringBanner = new Banner("steering");
    this.status = new StatusLine();
    this.help = createHelp();
    const actions = this.actions();
    this.toolbar = createToolbar(actions, () => this.toolbarState(), (name) => this.viewLabel(name));
    const banners = [this.connectionBanner.element, this.steeringBanner.element];
    this.stage = createElement(
      "main", {class: "stage"}, picture, this.surface, this.toolbar.element,
      createElement("div", {class: "banners"}, ...banners), this.toasts.element, this.status.element,
    );
    this.sidebar = createElement("aside", {class: "sidebar", "aria-label": "Settings"});
    this.element = createElement(
      "div", {class: "clusterviz", tabindex: "-1", "data-lm-suppress-shortcuts": "true"},
      this.stage, this.sidebar, this.help,
    );
    parent.append(this.element);
    this.viewInput = new ViewInput(this.element, this.surface, this.controls(actions));
    this.sidebar.append(createPanels(this));
    this.toolbar.update();
  }

  toolbarState() {
    return {
      parallel: (this.camera?.parallel_scale ?? null) !== null,
      flying: this.viewInput?.flying ?? false,
      sidebar: !this.element?.classList.contains("without-sidebar"),
    };
  }

  /** What input.js acts on. */
  controls(actions) {
    return {
      camera: () => this.camera,
      move: (camera) => { this.stopAnimation(); this.setCamera(camera, {moving: true}); },
      flush: () => this.flush(),
      settle: () => this.setCamera(this.camera, {moving: false}),
      allowed: () => this.mayMove(),
      radius: () => boundingSphere(this.corners()).radius,
      grab: (x, y) => (this.steers ? this.overlayCanvas.grab(x, y) : null),
      hover: (x, y) => this.overlayCanvas.hover(x, y),
      pick: (x, y, centre) => this.pick(x, y, centre),
      actions,
    };
  }

  actions() {
    const views = VIEWS.map((name) => [name, () => this.showView(name)]);
    return {
      ...Object.fromEntries(views),
      fit: () => this.showFitted(),
      projection: () => this.moveTo(otherProjection(this.camera), 0),
      fly: () => { this.viewInput.flying = !this.viewInput.flying; this.toolbar.update(); },
      sidebar: () => { this.element.classList.toggle("without-sidebar"); this.toolbar.update(); },
      pick: () => this.pick(this.viewInput.cursor.x, this.viewInput.cursor.y, false),
      play: () => this.play(),
      undo: () => this.send({type: "undo"}),
      redo: () => this.send({type: "redo"}),
      reset: () => this.send({type: "reset"}),
      help: () => this.help.showModal(),
    };
  }

  // Events -------------------------------------------------------------------------------------------------------

  /** @param {string} event @param {(value: any) => void} listener @returns {() => void} removes the listener */
  on(event, listener) {
    if (!this.listeners.has(event)) this.listeners.set(event, new Set());
    this.listeners.get(event).add(listener);
    return () => this.listeners.get(event).delete(listener);
  }

  emit(event, value) {
    for (const listener of this.listeners.get(event) ?? []) listener(value);
  }

  listen() {
    this.connection.onText((message) => this.received(message));
    this.connection.onBinary((data) => this.receivedBinary(parseBinary(data)));
    this.connection.onStatus?.((status) => this.connectionChanged(status));
    this.connection.onClose(() => this.connectionChanged({state: "closed"}));
    this.resizeObserver = new ResizeObserver((entries) => this.resized(entries[0]));
    this.resizeObserver.observe(this.stage);
    this.clock = setInterval(() => this.updateStatus(), 500);
  }

  received(message) {
    if (["hello", "state", "statistics"].includes(message.type)) this[message.type] = message;
    const handlers = {
      hello: () => this.greeted(), state: () => this.stateChanged(), error: () => this.failed(message),
      statistics: () => this.overlayCanvas.draw(), picked: () => this.pickAnswered(message),
      ended: () => this.ended(message),
    };
    handlers[message.type]?.();
    this.emit(message.type, message);
  }

  receivedBinary({header, payload}) {
    if (header.kind === "file") {
      this.emit("file", {header, payload});
      return;
    }
    this.pictureCanvas.show(header, payload).catch(
      (error) => this.notify(`Picture ${header.picture} cannot be shown: ${error.message}`),
    );
  }

  greeted() {
    this.pictureCanvas.restart();
    this.input = 0;
    this.sentTimes.clear();
    this.sizeWanted = true;
    this.connectionBanner.show("");
    this.updateStatus();
  }

  stateChanged() {
    if (!this.camera) this.camera = completeCamera(this.state.scene.camera);
    if (this.sizeWanted) this.sendSize();
    showSteering(this.steeringBanner, this.hello?.client, this.state, (action, client) => this.steer(action, client));
    this.overlayCanvas.stateChanged();
    this.toolbar.update();
    this.updateStatus();
  }

  steer(action, client) {
    this.send(client === undefined ? {type: "steer", action} : {type: "steer", action, client});
  }

  failed({message, key}) {
    this.notify(message, key);
  }

  /** Show a message for a while. @param {string} message @param {?string} key of the scene */
  notify(message, key = null) {
    this.toasts.show(message, key);
  }

  connectionChanged(status) {
    if (this.hasEnded) return;
    const text = {
      open: "", lost: `Connection lost. Attempt ${status.attempt} to connect…`,
      closed: "The session has ended: the server does not answer.",
    }[status.state];
    const buttons = text && this.connection.retry ? [["Connect now", () => this.connection.retry()]] : [];
    this.connectionBanner.show(text, ...buttons);
    this.status.connection = status.state;
    this.element.classList.toggle("disconnected", status.state !== "open");
    this.emit("connection", status);
    this.updateStatus();
  }

  ended({message}) {
    this.connectionChanged({state: "closed"});
    this.hasEnded = true;
    this.connectionBanner.show(message ? `The session has ended: ${message}` : "The session has ended.");
    this.connection.close();
  }

  // Messages to the session --------------------------------------------------------------------------------------

  /** Whether this client's input is followed. */
  get steers() {
    return this.state !== null && [null, undefined, this.hello?.client].includes(this.state.steering);
  }

  mayMove() {
    if (this.camera && !this.steers) this.notify(`Client ${this.state.steering} steers. Ask to steer at the top.`);
    return this.camera !== null && this.steers && !this.hasEnded;
  }

  /** Send a message at once. @param {object} message */
  send(message) {
    this.connection.send(message);
  }

  /** Change keys of the scene; null stands for the default. Changes of one animation frame become one message.
   * @param {Record<string, any>} changes by full path, such as "volumes.0.clim"
   * @param {{moving?: boolean, merge?: string}} options merge: edits with one tag are one step of undo
   * @returns {number} number of the input */
  edit(changes, {moving = false, merge} = {}) {
    if (this.pendingEdit && this.pendingEdit.merge !== merge) this.flush();
    const before = this.pendingEdit?.changes ?? {};
    this.pendingEdit = {type: "edit", changes: {...before, ...changes}, moving, input: this.nextInput()};
    if (merge !== undefined) this.pendingEdit.merge = merge;
    return this.pendingEdit.input;
  }

  /** Change the camera. @param {import("./camera.js").Camera} camera @param {{moving?: boolean}} options */
  setCamera(camera, {moving = false} = {}) {
    this.camera = camera;
    this.pendingView = {type: "view", camera, moving, input: this.nextInput()};
    this.emit("camera", camera);
    return this.input;
  }

  nextInput() {
    this.input += 1;
    this.sentTimes.set(this.input, performance.now());
    this.frame ||= requestAnimationFrame(() => this.flush());
    return this.input;
  }

  flush() {
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    const messages = [this.pendingView, this.pendingEdit].filter(Boolean).sort((a, b) => a.input - b.input);
    this.pendingView = this.pendingEdit = null;
    messages.forEach((message) => this.send(message));
  }

  // Pictures -----------------------------------------------------------------------------------------------------

  /** @returns {?import("./picture.js").PictureHeader} of the picture that is shown */
  get picture() {
    return this.pictureCanvas.header;
  }

  pictureShown(header) {
    const latency = this.latencyOf(header.input);
    if (this.followsPicture(header)) {
      this.camera = completeCamera(header.camera);
      this.emit("camera", this.camera);
      this.toolbar.update();
    }
    this.overlayCanvas.draw();
    this.status.pictureShown(header, latency);
    this.emit("picture", {...header, latency});
    this.updateStatus();
  }

  /** Whether the picture's camera is at least as new as this client's newest one. */
  followsPicture(header) {
    if (this.viewInput.active || this.animation || this.pendingView) return false;
    return !this.steers || header.input >= this.input;
  }

  /** @returns {?number} milliseconds from an input of this client to now, null if it was shown before */
  latencyOf(input) {
    const sent = this.sentTimes.get(input);
    for (const number of this.sentTimes.keys()) if (number <= input) this.sentTimes.delete(number);
    return sent === undefined ? null : performance.now() - sent;
  }

  resized(entry) {
    const width = devicePixels(entry.contentRect.width, entry.devicePixelContentBoxSize?.[0].inlineSize);
    const height = devicePixels(entry.contentRect.height, entry.devicePixelContentBoxSize?.[0].blockSize);
    if (width < 1 || height < 1) return;
    this.size = {width, height};
    this.pictureCanvas.resize(width, height);
    [this.surface.width, this.surface.height] = [width, height];
    this.overlayCanvas.draw();
    clearTimeout(this.resizeTimer);
    if (this.state) this.resizeTimer = setTimeout(() => this.sendSize(), RESIZE_MILLISECONDS);
  }

  sendSize() {
    if (!this.size) return;
    const {width, height} = this.size;
    this.sizeWanted = false;
    const share = Math.min(1, MAX_SIDE / Math.max(width, height));
    const [columns, rows] = [width, height].map((side) => Math.max(1, Math.round(side * share)));
    this.send({type: "size", width: columns, height: rows});
  }

  // Camera -------------------------------------------------------------------------------------------------------

  /** Corners of everything shown, world. */
  corners() {
    return boxCorners(this.state.bounds);
  }

  get orientation() {
    return this.state?.volumes?.[0]?.orientation ?? "";
  }

  viewLabel(name) {
    const {label} = namedView(name, this.orientation);
    return label[0].toUpperCase() + label.slice(1);
  }

  get aspect() {
    return this.surface.width / this.surface.height;
  }

  /** Fit everything into the picture, along the present direction. */
  showFitted() {
    if (this.mayMove()) this.moveTo(fitted(this.camera, this.corners(), this.aspect));
  }

  /** Show everything from a side. @param {string} name front, back, left, right, top or bottom */
  showView(name) {
    if (!this.mayMove()) return;
    const {toward, up} = namedView(name, this.orientation);
    this.moveTo(fitted(this.camera, this.corners(), this.aspect, toward, up));
  }

  /** Move the camera there within a moment; at once where reduced motion is wanted.
   * @param {import("./camera.js").Camera} target @param {number} seconds */
  moveTo(target, seconds = ANIMATION_SECONDS) {
    if (!this.mayMove()) return;
    const from = this.camera;
    const reduced = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.animate(reduced ? 0 : seconds, (share) => interpolateCamera(from, target, share * share * (3 - 2 * share)));
  }

  /** @param {number} seconds @param {(share: number) => import("./camera.js").Camera} cameraAt share: 0 … 1 */
  animate(seconds, cameraAt) {
    this.stopAnimation();
    const start = performance.now();
    const step = () => {
      const share = seconds > 0 ? Math.min(1, (performance.now() - start) / 1000 / seconds) : 1;
      this.animation = share < 1 ? requestAnimationFrame(step) : 0;
      this.setCamera(cameraAt(share), {moving: share < 1});
      this.flush();
    };
    step();
  }

  stopAnimation() {
    cancelAnimationFrame(this.animation);
    this.animation = 0;
  }

  /** Set the key frames that `play` shows. @param {import("./path.js").CameraKey[]} keys */
  setPath(keys) {
    this.path = keys;
  }

  /** Play the camera path, or stop it. */
  play() {
    if (this.animation) {
      this.stopAnimation();
      this.setCamera(this.camera);
      return;
    }
    const keys = this.path;
    if (keys.length < 2) {
      this.notify("There is no camera path yet: add two key frames.");
      return;
    }
    if (!this.mayMove()) return;
    const [first, last] = [keys[0].time, keys[keys.length - 1].time];
    this.animate(last - first, (share) => cameraOnPath(keys, first + share * (last - first)));
  }

  // Picks and the overlay ----------------------------------------------------------------------------------------

  /** Ask for position and value at a point, CSS pixels. @param {boolean} centre move the focal point there */
  pick(x, y, centre) {
    if (!this.picture) return;
    const {left, top, width, height} = this.pictureCanvas.rectangle();
    const ratio = this.surface.width / this.surface.clientWidth;
    const point = [(x * ratio - left) / width, (y * ratio - top) / height];
    if (point.some((share) => share < 0 || share >= 1)) return;
    this.picks += 1;
    this.centringPick = centre ? this.picks : this.centringPick;
    this.send({type: "pick", x: point[0], y: point[1], pick: this.picks});
  }

  pickAnswered(message) {
    this.picked = message.position && {position: message.position, text: pickText(message, this.nameOf(message.name))};
    this.overlayCanvas.draw();
    if (message.position && message.pick === this.centringPick) this.moveTo(centred(this.camera, message.position));
  }

  /** Name of a volume, geometry, grid or flow. @param {string} key such as volumes.0 */
  nameOf(key) {
    const {volumes = [], geometry = [], grids = [], flows = []} = this.state;
    return [...volumes, ...geometry, ...grids, ...flows].find((each) => each.key === key)?.name ?? key;
  }

  /** Switch parts of the overlay. @param {Record<string, boolean>} changes axes, boxes, clip, pick */
  setOverlay(changes) {
    Object.assign(this.overlay, changes);
    this.overlayCanvas.draw();
    this.emit("overlay", this.overlay);
  }

  updateStatus() {
    this.status.update(this.hello, this.state, this.steers ? this.input : 0);
  }

  destroy() {
    this.stopAnimation();
    cancelAnimationFrame(this.frame);
    clearTimeout(this.resizeTimer);
    clearInterval(this.clock);
    this.resizeObserver.disconnect();
    this.viewInput.destroy();
    this.toasts.destroy();
    this.connection.close();
    this.element.remove();
  }
}

/** @type {(camera: object) => import("./camera.js").Camera} keys that are left out get their defaults */
function completeCamera({position, focal_point, view_up, view_angle = 30, parallel_scale = null}) {
  return {position, focal_point, view_up, view_angle, parallel_scale};
}

/** Device pixels of a length, as the browser lays it out where it says so, and where that is not the emulated device's.
 * @type {(length: number, laidOut: number | undefined) => number} */
function devicePixels(length, laidOut = NaN) {
  const scaled = length * window.devicePixelRatio;
  return Math.abs(laidOut - scaled) <= 1 ? laidOut : Math.round(scaled);
}

function pickText({position, index, value}, name) {
  const short = (number) => String(Number(number.toPrecision(5)));
  const lines = [value === null || value === undefined ? name : `${name ?? "value"}: ${short(value)}`];
  lines.push(`(${position.map(short).join(", ")})`);
  if (index) lines.push(`index ${index.map((each) => Number(each.toFixed(1))).join(", ")}`);
  return lines.filter(Boolean).join("\n");
}
