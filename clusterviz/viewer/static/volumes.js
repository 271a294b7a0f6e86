// Panel of the contents: which are shown, and the editor of the selected one.

import {Form, labelled, valueAt} from "./controls.js";
import {createElement} from "./elements.js";
import {TransferEditor} from "./transfer.js";
import {contentEntry} from "./transfer_model.js";

const CONTENT_KINDS = {volumes: "volume", meshes: "mesh", lines: "lines", points: "points", grids: "grid", flows: "flow"};
const LONGEST_NAME = 34;

/** A name that fits into a row: long ones lose their middle, since beginnings and endings differ. */
function shortenedName(name) {
  const half = LONGEST_NAME / 2 - 1;
  return name.length > LONGEST_NAME ? `${name.slice(0, half)}…${name.slice(-half)}` : name;
}

/** Paths of everything that a scene shows, such as "volumes.0". */
export function contentPaths(scene) {
  return Object.keys(CONTENT_KINDS).flatMap((name) => (scene[name] ?? []).map((_, index) => `${name}.${index}`));
}

export class ContentsPanel {
  /** @param {import("./viewer.js").Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.selected = "";
    this.built = "";
    this.list = createElement("div", {class: "content-list", role: "list"});
    this.list.dataset.key = "hidden";
    this.editor = createElement("div", {class: "content-editor"});
    this.element = createElement("div", {}, this.list, this.editor);
  }

  show(state) {
    const paths = contentPaths(state.scene);
    if (!paths.includes(this.selected)) this.selected = paths[0] ?? "";
    this.showList(state, paths);
    const kind = this.selected && editorKind(state, this.selected);
    const signature = `${this.selected} ${kind}`;
    if (signature !== this.built) this.rebuild(state, kind);
    this.built = signature;
    this.parts.forEach((part) => part.show(state));
  }

  showList(state, paths) {
    const items = paths.map((path) => this.item(state, path));
    const focused = this.list.contains(document.activeElement) ? document.activeElement.dataset.focus : null;
    this.list.replaceChildren(...items);
    if (focused) this.list.querySelector(`[data-focus="${focused}"]`)?.focus();
    if (!paths.length) this.list.append(createElement("div", {class: "note"}, "The scene has no contents."));
  }

  item(state, path) {
    const hidden = state.hidden ?? [];
    const isShown = !hidden.includes(path);
    const name = contentEntry(state, path).name ?? valueAt(state.scene, path).path;
    const title = isShown ? "Hide" : "Show";
    const eye = createElement("input", {type: "checkbox", title, "data-focus": `eye ${path}`});
    eye.checked = isShown;
    eye.disabled = !this.viewer.steers;
    eye.setAttribute("aria-label", `Show ${name}`);
    eye.addEventListener("change", () => {
      const others = hidden.filter((one) => one !== path);
      this.viewer.edit({hidden: eye.checked ? others : [...others, path]}, {moving: false});
    });
    const choose = createElement("button", {type: "button", class: "content-name", title: name, "data-focus": path});
    const kind = CONTENT_KINDS[path.split(".")[0]];
    choose.append(createElement("span", {class: "name"}, shortenedName(name)));
    choose.append(createElement("span", {class: "kind"}, kind));
    choose.addEventListener("click", () => this.choose(path));
    const isSelected = path === this.selected;
    if (isSelected) choose.ariaCurrent = "true";
    return createElement("div", {class: "content-item", role: "listitem"}, eye, choose);
  }

  choose(path) {
    this.selected = path;
    this.show(this.viewer.state);
  }

  rebuild(state, kind) {
    this.parts = [];
    const form = new Form(this.viewer);
    const make = {volume: volumeEditor, grid: gridEditor, flow: flowEditor, scalars: scalarsEditor, solid: solidEditor}[kind];
    this.editor.replaceChildren(...(make ? make(this, form, this.selected, state) : []));
    this.parts.push(form);
  }
}

/** Which editor a content needs: "volume", "grid", "flow", or of geometry "scalars" or "solid". */
function editorKind(state, path) {
  if (path.startsWith("volumes")) return "volume";
  if (path.startsWith("grids")) return "grid";
  if (path.startsWith("flows")) return "flow";
  return contentEntry(state, path).colour_points ? "scalars" : "solid";
}

function volumeEditor(panel, form, path, state) {
  const transfer = new TransferEditor(panel.viewer, path);
  panel.parts.push(transfer);
  const mode = form.select(`${path}.blending`, "Blend mode", undefined, (value) => surfacesFor(panel, path, value));
  const threshold = form.number(`${path}.threshold`, "Threshold", {empty: true});
  form.bind(`${path}.blending`, mode, (value) => (threshold.hidden = !modeFacts(panel, value).threshold));
  return [
    presetRow(panel, path),
    transfer.element,
    notes(form, path),
    unitDistance(form, path, state),
    mode,
    threshold,
    form.select(`${path}.interpolation`, "Interpolation"),
    material(form, path, [form.select(`${path}.gradient`, "Gradient"), occlusion(form, path, state)]),
  ];
}

function gridEditor(panel, form, path, state) {
  const transfer = new TransferEditor(panel.viewer, path);
  panel.parts.push(transfer);
  return [transfer.element, unitDistance(form, path, state), material(form, path)];
}

function flowEditor(panel, form, path) {
  return [form.colour(`${path}.color`, "Colour"), material(form, path)];
}

function scalarsEditor(panel, form, path, state) {
  const isNumber = typeof valueAt(state.scene, path).opacity === "number";
  const transfer = new TransferEditor(panel.viewer, path);
  panel.parts.push(transfer);
  const opacity = isNumber ? [form.slider(`${path}.opacity`, "Opacity", {low: 0, high: 1})] : [];
  return [transfer.element, ...opacity, ...geometryRows(form, path, state), material(form, path)];
}

function solidEditor(panel, form, path, state) {
  const opacity = form.slider(`${path}.opacity`, "Opacity", {low: 0, high: 1});
  return [form.colour(`${path}.color`, "Colour"), opacity, ...geometryRows(form, path, state), material(form, path)];
}

function geometryRows(form, path, state) {
  const section = valueAt(state.scene, path);
  const rows = [];
  if (typeof section.radius === "number") {
    const size = sceneDiagonal(state);
    rows.push(form.slider(`${path}.radius`, "Radius", {low: 1e-5 * size, high: 0.1 * size, log: true}));
  }
  const isMesh = "culling" in section;
  if (isMesh) rows.push(form.select(`${path}.shading`, "Normals"), form.select(`${path}.culling`, "Culling"));
  return rows;
}

/** What is known of a blend mode: whether it has a threshold, and whether isosurfaces are allowed, required or refused. */
function modeFacts(panel, mode) {
  return panel.viewer.hello?.blend_modes?.[mode] ?? {};
}

/** Keys that have to change with a blend mode, as far as it requires isosurfaces or refuses them. */
function surfacesFor(panel, path, mode) {
  const {surfaces} = modeFacts(panel, mode);
  const {isosurfaces, clim} = valueAt(panel.viewer.state.scene, path);
  const middle = Number(((clim[0] + clim[1]) / 2).toPrecision(4));
  if (surfaces === "required" && !isosurfaces.length) return {[`${path}.isosurfaces`]: [[middle, 1]]};
  return surfaces === "refused" && isosurfaces.length ? {[`${path}.isosurfaces`]: []} : {};
}

function presetRow(panel, path) {
  const presets = panel.viewer.hello?.presets ?? [];
  const select = createElement("select", {}, createElement("option", {value: ""}, "choose…"));
  const option = ({name, description}) => createElement("option", {value: name}, `${name} – ${description}`);
  select.append(...presets.map(option));
  select.addEventListener("change", () => {
    panel.viewer.send({type: "preset", volume: Number(path.split(".")[1]), name: select.value});
    select.value = "";
  });
  const row = labelled("Preset", select);
  row.dataset.key = "preset";
  return row;
}

/** Read-only notes about keys that take the place of opacity or colours. */
function notes(form, path) {
  const table = createElement("div", {class: "note"});
  form.bind(`${path}.transfer_2d`, table, (value) => {
    table.hidden = !value;
    table.textContent = value ? `Opacity is a table over value and gradient magnitude: ${value.path}` : "";
  });
  const shader = createElement("div", {class: "note"});
  form.bind(`${path}.shader`, shader, (value) => {
    shader.hidden = !value;
    shader.textContent = value ? `Colours are those of a shader: ${value}` : "";
  });
  return createElement("div", {}, table, shader);
}

function unitDistance(form, path, state) {
  const size = sceneDiagonal(state);
  return form.slider(`${path}.opacity_unit_distance`, "Unit distance", {low: 1e-4 * size, high: size, log: true});
}

function material(form, path, more = []) {
  const share = {low: 0, high: 1};
  const body = createElement("details", {class: "material"}, createElement("summary", {}, "Shading"));
  body.append(
    form.check(`${path}.shade`, "Shade"),
    form.slider(`${path}.ambient`, "Ambient", share),
    form.slider(`${path}.diffuse`, "Diffuse", share),
    form.slider(`${path}.specular`, "Specular", share),
    form.slider(`${path}.specular_power`, "Power", {low: 1, high: 128, log: true}),
    ...more,
  );
  return body;
}

function occlusion(form, path, state) {
  const radius = Number((0.03 * sceneDiagonal(state)).toPrecision(2));
  const entry = contentEntry(state, path);
  const voxels = Math.min(...(entry.spacing ?? [radius]).map((side) => 8 * side));
  const on = {radius: Math.min(radius, Number(voxels.toPrecision(2)))};
  return form.check(`${path}.ambient_occlusion`, "Ambient occlusion", {on, off: null});
}

/** Length of the diagonal of the box around the scene; 1 for an empty scene. */
export function sceneDiagonal(state) {
  const [low, high] = state.bounds ?? [[0, 0, 0], [1, 1, 1]];
  return Math.hypot(...high.map((value, axis) => value - low[axis])) || 1;
}
