// Panel of the clip planes and the clip box; their handles in the picture are the overlay's.

import {addScaled, cameraAxes, dot, normalized, subtract} from "./camera.js";
import {Form, button, labelled, onSlide, slidValue, slidePosition, sliderInput} from "./controls.js";
import {createElement} from "./elements.js";
import {sceneDiagonal} from "./volumes.js";

const AXIS_NAMES = ["x", "y", "z"];

function boundsCentre(state) {
  return state.bounds[0].map((low, axis) => (low + state.bounds[1][axis]) / 2);
}

function tidy(values) {
  return values.map((value) => Number(value.toPrecision(6)) + 0);
}

export class ClipPanel {
  constructor(viewer) {
    this.viewer = viewer;
    this.form = new Form(viewer);
    /** Planes that are switched off; they are this client's. */
    this.off = [];
    this.built = null;
    this.list = createElement("div", {class: "planes"});
    this.list.dataset.key = "clip.planes";
    this.handles = createElement("input", {type: "checkbox"});
    this.handles.addEventListener("change", () => viewer.setOverlay({clip: this.handles.checked}));
    const handles = createElement("label", {class: "row check"}, this.handles, "Handles in the picture");
    const add = createElement("div", {class: "row"}, createElement("span", {class: "label"}, "Add a plane"));
    add.append(...[...AXIS_NAMES, "view"].map((name) => button(name, () => this.add(name), {title: planeTitle(name)})));
    const cap = this.form.check("clip.cap", "Shade cut faces by their normals");
    this.box = createElement("div");
    this.element = createElement("div", {}, handles, this.list, add, this.box, cap);
    viewer.on("overlay", () => (this.handles.checked = viewer.overlay.clip));
  }

  get planes() {
    return this.viewer.state.scene.clip.planes;
  }

  send(planes, gesture = {moving: false}) {
    this.viewer.edit({"clip.planes": planes}, gesture);
  }

  /** Add a plane through the centre, whose kept side is that of larger coordinates, or away from the eye. */
  add(name) {
    const state = this.viewer.state;
    const axis = AXIS_NAMES.indexOf(name);
    const forward = cameraAxes(this.viewer.camera ?? state.scene.camera).forward;
    const normal = axis < 0 ? tidy(forward) : [0, 0, 0].with(axis, 1);
    this.send([...this.planes, [tidy(boundsCentre(state)), normal]]);
    this.viewer.setOverlay({clip: true});
  }

  show(state) {
    this.handles.checked = Boolean(this.viewer.overlay.clip);
    const signature = `${this.planes.length} ${this.off.length}`;
    if (signature !== this.built) this.rebuild(state);
    this.built = signature;
    if (!this.box.children.length) this.box.append(this.boxCard(state.bounds));
    this.planesForm.show(state);
    this.form.show(state);
  }

  rebuild(state) {
    this.planesForm = new Form(this.viewer);
    const on = this.planes.map((_, index) => this.planeCard(index, state));
    const off = this.off.map((plane, index) => this.offCard(plane, index));
    this.list.replaceChildren(...on, ...off);
  }

  planeCard(index, state) {
    const form = this.planesForm;
    const path = `clip.planes.${index}`;
    const [box, head] = planeHead(index, true, () => this.remove(index));
    box.addEventListener("change", () => {
      this.off.push(this.planes[index]);
      this.remove(index);
    });
    head.insertBefore(button("flip", () => this.flip(index), {title: "Keep the other side"}), head.lastChild);
    const titles = AXIS_NAMES;
    const rows = [form.vector(`${path}.0`, "Point", titles), form.vector(`${path}.1`, "Normal", titles)];
    return createElement("div", {class: "card"}, head, this.offset(index, state), ...rows);
  }

  offCard(plane, index) {
    const drop = () => {
      this.off.splice(index, 1);
      this.show(this.viewer.state);
    };
    const [box, head] = planeHead(this.planes.length + index, false, drop);
    box.addEventListener("change", () => {
      this.off.splice(index, 1);
      this.send([...this.planes, plane]);
    });
    return createElement("div", {class: "card off"}, head);
  }

  remove(index) {
    this.send(this.planes.toSpliced(index, 1));
  }

  flip(index) {
    const [point, normal] = this.planes[index];
    this.send(this.planes.with(index, [point, normal.map((part) => 0 - part)]));
  }

  /** A slider of a plane's distance from the scene's centre along its normal. */
  offset(index, state) {
    const reach = sceneDiagonal(state) / 2;
    const range = {low: -reach, high: reach};
    const slider = sliderInput();
    const row = labelled("Offset", slider);
    row.classList.add("with-slider");
    const centre = () => boundsCentre(this.viewer.state);
    onSlide(slider, "plane", (gesture) => {
      const [point, normal] = this.planes[index];
      const unit = normalized(normal);
      const step = slidValue(slider, range) - dot(subtract(point, centre()), unit);
      field.busy = gesture.moving;
      this.send(this.planes.with(index, [tidy(addScaled(point, unit, step)), normal]), gesture);
    });
    const field = this.planesForm.bind(`clip.planes.${index}.offset`, row, (_, current) => {
      const plane = current.scene.clip.planes[index];
      if (plane) slider.value = String(slidePosition(dot(subtract(plane[0], centre()), normalized(plane[1])), range));
    });
    return row;
  }

  /** The switch of the clip box, and its six sides. */
  boxCard(bounds) {
    const {viewer, form} = this;
    const whole = bounds[0].flatMap((low, axis) => [low, bounds[1][axis]]);
    const toggle = createElement("input", {type: "checkbox"});
    const rows = createElement("div", {}, ...whole.map((_, part) => boxRow(form, part, bounds)));
    const head = createElement("label", {class: "row check"}, toggle, "Clip box");
    const frame = createElement("div", {class: "card"}, head, rows);
    const field = form.bind("clip.box", frame, (box) => {
      toggle.checked = Boolean(box);
      rows.hidden = !box;
      this.lastBox = box ?? this.lastBox;
    });
    toggle.addEventListener("change", () => {
      form.send(field, toggle.checked ? (this.lastBox ?? tidy(whole)) : null);
      if (toggle.checked) viewer.setOverlay({clip: true});
    });
    return frame;
  }
}

function boxRow(form, part, bounds) {
  const axis = Math.floor(part / 2);
  const isUpper = part % 2 === 1;
  const limit = (value, box) => (isUpper ? Math.max(value, box[part - 1]) : Math.min(value, box[part + 1]));
  const options = {low: bounds[0][axis], high: bounds[1][axis], part, limit};
  return form.slider("clip.box", `${AXIS_NAMES[axis]} ${isUpper ? "max" : "min"}`, options);
}

function planeTitle(name) {
  return name === "view" ? "A plane across the view, through the centre" : `A plane across ${name}, through the centre`;
}

function planeHead(number, isOn, remove) {
  const box = createElement("input", {type: "checkbox", title: `Switch this plane ${isOn ? "off" : "on"}`});
  box.checked = isOn;
  const label = createElement("label", {class: "check"}, box, `Plane ${number + 1}`);
  const drop = button("✕", remove, {title: "Remove this plane", class: "icon"});
  return [box, createElement("div", {class: "row head"}, label, drop)];
}
