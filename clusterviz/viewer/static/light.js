// Panel of the lights: type, colour, intensity, and the direction on a sphere seen as in the picture.

import {addScaled, cameraAxes, dot, normalized, subtract} from "./camera.js";
import {Form, createSvg, button, newGesture} from "./controls.js";
import {createElement} from "./elements.js";
import {sceneDiagonal} from "./volumes.js";

const SPHERE_RADIUS = 44;

/**
 * Place of a direction in a disc: the centre is towards the eye, half the radius is across the view, the rim is away
 * from the eye.
 * @returns {[number, number]}  x to the right and y down, in -1..1
 */
export function discFromDirection(direction, axes) {
  const [x, y, z] = [dot(direction, axes.right), dot(direction, axes.up), -dot(direction, axes.forward)];
  const across = Math.hypot(x, y);
  const radius = Math.acos(Math.min(1, Math.max(-1, z))) / Math.PI;
  return across > 0 ? [(radius * x) / across, (-radius * y) / across] : [0, radius];
}

/** The direction, a unit vector of the world, at a place in the disc. */
export function directionFromDisc(x, y, axes) {
  const radius = Math.min(1, Math.hypot(x, y));
  const angle = radius * Math.PI;
  const across = radius > 0 ? Math.sin(angle) / Math.hypot(x, y) : 0;
  const toEye = addScaled([0, 0, 0], axes.forward, -Math.cos(angle));
  return normalized(addScaled(addScaled(toEye, axes.right, across * x), axes.up, -across * y));
}

export class LightsPanel {
  constructor(viewer) {
    this.viewer = viewer;
    this.built = null;
    this.list = createElement("div", {class: "lights"});
    this.list.dataset.key = "lights";
    const add = button("+ headlight", () => this.add({type: "headlight"}), {title: "A light that shines from the eye"});
    const scene = button("+ scene light", () => this.add(this.newLight()), {title: "A light fixed in the world"});
    this.element = createElement("div", {}, this.list, createElement("div", {class: "row"}, add, scene));
    this.stop = viewer.on("camera", () => this.spheres?.forEach((sphere) => sphere.draw()));
  }

  get lights() {
    return this.viewer.state.scene.lights;
  }

  add(light) {
    this.viewer.edit({lights: [...this.lights, light]}, {moving: false});
  }

  /** A light from above and the left of the eye. */
  newLight() {
    const state = this.viewer.state;
    const centre = state.bounds[0].map((low, axis) => (low + state.bounds[1][axis]) / 2);
    const direction = directionFromDisc(-0.2, -0.25, cameraAxes(this.viewer.camera ?? state.scene.camera));
    return {position: addScaled(centre, direction, sceneDiagonal(state)), focal_point: centre};
  }

  show(state) {
    const {lights} = state.scene;
    const signature = lights.map((light) => `${light.type} ${light.positional}`).join();
    if (signature !== this.built) this.rebuild(lights);
    this.built = signature;
    this.form.show(state);
  }

  rebuild(lights) {
    this.form = new Form(this.viewer);
    this.spheres = [];
    const none = createElement("div", {class: "note"}, "No lights of its own: one headlight.");
    this.list.replaceChildren(...(lights.length ? lights.map((light, index) => this.item(light, index)) : [none]));
  }

  item(light, index) {
    const path = `lights.${index}`;
    const remove = () => this.viewer.edit({lights: this.lights.toSpliced(index, 1)}, {moving: false});
    const title = createElement("span", {class: "label"}, light.type === "headlight" ? "Headlight" : "Scene light");
    const drop = button("✕", remove, {title: "Remove this light", class: "icon"});
    const head = createElement("div", {class: "row head"}, title, drop);
    const intensity = this.form.slider(`${path}.intensity`, "Intensity", {low: 0, high: 2});
    const rows = [this.form.colour(`${path}.color`, "Colour"), intensity];
    if (light.type === "scene") rows.push(...this.sceneRows(path, index, light.positional));
    return createElement("div", {class: "card"}, head, ...rows);
  }

  sceneRows(path, index, isPositional) {
    const sphere = new LightSphere(this.viewer, this.form, index);
    this.spheres.push(sphere);
    const cone = isPositional ? [this.form.slider(`${path}.cone_angle`, "Cone angle", {low: 1, high: 90})] : [];
    return [
      sphere.element,
      this.form.vector(`${path}.position`, "Position", ["x", "y", "z"]),
      this.form.check(`${path}.positional`, "Shines from its position"),
      ...cone,
    ];
  }
}

/** Direction of a scene light: a dot in a disc that is dragged, or moved by arrow keys. */
class LightSphere {
  constructor(viewer, form, index) {
    this.viewer = viewer;
    this.form = form;
    this.index = index;
    this.dot = createSvg("circle", {r: 6, class: "light-dot"});
    const size = SPHERE_RADIUS + 8;
    const label = "Direction of the light. Centre: from the eye; inner circle: from the side; rim: from behind.";
    this.svg = createSvg("svg", {viewBox: `${-size} ${-size} ${2 * size} ${2 * size}`, class: "sphere", tabindex: 0});
    this.svg.append(createSvg("title", {}, label), createSvg("circle", {r: SPHERE_RADIUS, class: "rim"}));
    this.svg.append(createSvg("circle", {r: SPHERE_RADIUS / 2, class: "side"}), this.dot);
    this.element = createElement("div", {class: "row"}, createElement("span", {class: "label"}, "Direction"), this.svg);
    this.field = form.bind(`lights.${index}.position`, this.element, () => this.draw());
    this.listen();
  }

  get light() {
    return this.viewer.state.scene.lights[this.index];
  }

  get axes() {
    return cameraAxes(this.viewer.camera ?? this.viewer.state.scene.camera);
  }

  draw() {
    if (!this.light?.position || this.field.busy) return;
    const direction = normalized(subtract(this.light.position, this.light.focal_point));
    this.place(...discFromDirection(direction, this.axes));
  }

  place(x, y) {
    [this.x, this.y] = [x, y];
    this.dot.setAttribute("cx", String(x * SPHERE_RADIUS));
    this.dot.setAttribute("cy", String(y * SPHERE_RADIUS));
    this.dot.classList.toggle("behind", Math.hypot(x, y) > 0.5);
  }

  listen() {
    this.svg.addEventListener("pointerdown", (event) => {
      if (!this.viewer.steers) return;
      this.svg.setPointerCapture(event.pointerId);
      this.merge = newGesture("light");
      this.drag(event, true);
    });
    this.svg.addEventListener("pointermove", (event) => this.merge && this.drag(event, true));
    this.svg.addEventListener("pointerup", (event) => {
      if (this.merge) this.drag(event, false);
      this.merge = null;
    });
    this.svg.addEventListener("keydown", (event) => this.key(event));
  }

  drag(event, moving) {
    const box = this.svg.getBoundingClientRect();
    const scale = (2 * (SPHERE_RADIUS + 8)) / box.width / SPHERE_RADIUS;
    const x = (event.clientX - box.left - box.width / 2) * scale;
    const y = (event.clientY - box.top - box.height / 2) * scale;
    this.send(x, y, {moving, merge: this.merge});
  }

  key(event) {
    const step = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (!step || !this.viewer.steers) return;
    event.preventDefault();
    event.stopPropagation();
    this.send(this.x + 0.05 * step[0], this.y + 0.05 * step[1], {merge: `light ${this.index} keys`});
  }

  send(x, y, gesture) {
    const shrink = 1 / Math.max(1, Math.hypot(x, y));
    this.place(x * shrink, y * shrink);
    const {position, focal_point: focalPoint} = this.light;
    const distance = Math.hypot(...subtract(position, focalPoint));
    const direction = directionFromDisc(this.x, this.y, this.axes);
    const moved = addScaled(focalPoint, direction, distance).map((value) => Number(value.toPrecision(6)));
    this.form.send(this.field, moved, gesture);
  }
}
