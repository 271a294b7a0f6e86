// Panel of the picture: background, projection and annotations.

import {halfHeight, otherProjection} from "./camera.js";
import {Form, button, hexColour, hexOfCss, labelled, newGesture, onSlide, rgbOfHex} from "./controls.js";
import {createElement} from "./elements.js";
import {formatNumber, numberInput, showText, slidValue, slidePosition, sliderInput} from "./controls.js";

const ANNOTATION_LABELS = {
  scalar_bar: "Scalar bar",
  outline: "Outline",
  axes: "Axes grid",
  orientation: "Orientation marker",
  scale_bar: "Scale bar",
  time: "Time stamp",
  legend: "Legend",
};
const ANGLES = {low: 5, high: 120};

export class AppearancePanel {
  constructor(viewer) {
    this.viewer = viewer;
    this.form = new Form(viewer);
    this.annotations = createElement("div");
    const rows = [this.backgroundRow(), this.angleRow(), this.projectionRow(), this.annotations];
    this.element = createElement("div", {}, ...rows);
    viewer.on("camera", () => this.showCamera());
  }

  show(state) {
    if (state.scene.annotations && !this.annotations.children.length) this.buildAnnotations();
    this.form.show(state);
    this.showCamera();
  }

  backgroundRow() {
    const input = createElement("input", {type: "color", title: "Background colour"});
    const send = (value, gesture) => this.form.send(field, value, gesture);
    let merge = newGesture("background");
    input.addEventListener("input", () => send(rgbOfHex(input.value), {moving: true, merge}));
    input.addEventListener("change", () => {
      send(rgbOfHex(input.value), {merge});
      merge = newGesture("background");
    });
    const names = ["white", "black", "transparent"].map((name) => button(name, () => send(name)));
    const row = labelled("Background", input, ...names);
    const field = this.form.bind("image.background", row, (value) => {
      input.value = typeof value === "string" ? hexOfCss(value) : hexColour(value);
      names.forEach((one) => one.setAttribute("aria-pressed", String(one.textContent === value)));
    });
    return row;
  }

  get camera() {
    return this.viewer.camera ?? this.viewer.state?.scene.camera;
  }

  angleRow() {
    this.angle = sliderInput();
    const send = (value, moving = false) => this.viewer.setCamera({...this.camera, view_angle: value}, {moving});
    this.angleNumber = numberInput((value) => Number.isFinite(value) && value > 0 && value < 180 && send(value));
    onSlide(this.angle, "angle", ({moving}) => send(slidValue(this.angle, ANGLES), moving));
    this.angleLine = labelled("View angle", this.angle, this.angleNumber);
    this.angleLine.classList.add("with-slider");
    this.angleLine.dataset.key = "camera.view_angle";
    return this.angleLine;
  }

  projectionRow() {
    this.parallel = createElement("input", {type: "checkbox"});
    this.parallel.addEventListener("change", () => this.viewer.setCamera(otherProjection(this.camera)));
    this.scale = createElement("span", {class: "muted"});
    const row = createElement("label", {class: "row check"}, this.parallel, "Parallel projection", this.scale);
    row.dataset.key = "camera.parallel_scale";
    return row;
  }

  showCamera() {
    const {camera} = this;
    if (!camera) return;
    const isParallel = camera.parallel_scale != null;
    this.parallel.checked = isParallel;
    this.scale.textContent = isParallel ? `height ${formatNumber(2 * halfHeight(camera))}` : "";
    this.angleLine.classList.toggle("unused", isParallel);
    if (document.activeElement !== this.angle) this.angle.value = String(slidePosition(camera.view_angle, ANGLES));
    showText(this.angleNumber, formatNumber(camera.view_angle));
  }

  buildAnnotations() {
    const {form} = this;
    const boxes = Object.entries(ANNOTATION_LABELS).map(([name, label]) => form.check(`annotations.${name}`, label));
    this.annotations.append(
      createElement("div", {class: "subtitle"}, "Annotations"),
      createElement("div", {class: "two-columns"}, ...boxes),
      textRow(form, "annotations.title", "Title"),
      textRow(form, "annotations.text", "Text"),
      form.slider("annotations.font_size", "Font size", {low: 0.01, high: 0.08}),
    );
  }
}

/** Lines of text in one field, divided by "|". */
function textRow(form, key, label) {
  const input = createElement("input", {type: "text", class: "text", placeholder: "a line | another line"});
  input.addEventListener("input", () => (input.dataset.typed = "yes"));
  input.addEventListener("change", () => {
    input.dataset.typed = "";
    form.send(field, input.value.trim() ? input.value.split("|").map((line) => line.trim()) : []);
  });
  const row = labelled(label, input);
  const field = form.bind(key, row, (lines) => showText(input, (lines ?? []).join(" | ")));
  return row;
}
