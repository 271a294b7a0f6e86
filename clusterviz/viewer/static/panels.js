// Side bar of panels beside the picture.

import {AppearancePanel} from "./appearance.js";
import {ClipPanel} from "./clip.js";
import {button} from "./controls.js";
import {createElement} from "./elements.js";
import {LightsPanel} from "./light.js";
import {QualityPanel} from "./quality.js";
import {SavePanel} from "./save.js";
import {StatisticsPanel} from "./statistics.js";
import {ContentsPanel} from "./volumes.js";

/** Panels from top to bottom: title, class, whether it is open at first, whether a client that watches may use it. */
const PANELS = [
  ["Contents", ContentsPanel, true, false],
  ["Lights", LightsPanel, false, false],
  ["Clipping", ClipPanel, false, false],
  ["Picture", AppearancePanel, false, false],
  ["Quality", QualityPanel, false, false],
  ["Statistics", StatisticsPanel, false, true],
  ["Save", SavePanel, false, true],
];

/**
 * Create the side bar.
 * @param {import("./viewer.js").Viewer} viewer
 * @returns {HTMLElement}
 */
export function createPanels(viewer) {
  const history = historyRow(viewer);
  const frames = PANELS.map(([title, Panel, ...options]) => panelFrame(title, new Panel(viewer), ...options));
  const warnings = createElement("div", {class: "warnings", role: "status"});
  const parts = [history.element, warnings, ...frames.map((frame) => frame.element)];
  const element = createElement("div", {class: "panels"}, ...parts);
  const show = (state) => {
    clearErrors(element);
    history.show(state);
    warnings.replaceChildren(...(state.warnings ?? []).map((text) => createElement("div", {class: "warning"}, text)));
    frames.forEach((frame) => frame.show(state, viewer.steers));
  };
  viewer.on("state", show);
  viewer.on("error", (error) => showError(element, error));
  if (viewer.state) show(viewer.state);
  return element;
}

function historyRow(viewer) {
  const step = (type, text, title) => button(text, () => viewer.send({type}), {title});
  const undo = step("undo", "↶ Undo", "Undo the last change (Ctrl Z)");
  const redo = step("redo", "↷ Redo", "Redo (Ctrl Shift Z)");
  const reset = step("reset", "Reset", "The scene as it was opened");
  const show = (state) => {
    const steers = viewer.steers;
    undo.disabled = !steers || !state.can_undo;
    redo.disabled = !steers || !state.can_redo;
    reset.disabled = !steers;
  };
  const spacer = createElement("span", {class: "spacer"});
  return {element: createElement("div", {class: "history"}, undo, redo, spacer, reset), show};
}

/** A panel that can be folded; its contents are shown while it is open. */
function panelFrame(title, panel, isOpen, isForAll) {
  const fields = createElement("fieldset", {}, panel.element);
  const element = createElement("details", {class: "panel", open: isOpen, "data-panel": title.toLowerCase()});
  element.append(createElement("summary", {}, title), fields);
  let newest = null;
  const showNewest = () => element.open && newest && panel.show(newest);
  element.addEventListener("toggle", showNewest);
  const show = (state, steers) => {
    newest = state;
    fields.disabled = !isForAll && !steers;
    element.classList.toggle("watching", fields.disabled);
    showNewest();
  };
  return {element, show};
}

/** Show an error at the field of its key, or of the longest key before it that has a field. */
export function showError(root, {key, message}) {
  const path = key?.replace(/\[(\d+)\]/g, ".$1");
  const place = path && fieldOfKey(root, path);
  if (!place) return;
  place.classList.add("invalid");
  const text = createElement("div", {class: "error-text", role: "alert"}, message);
  place.parentNode.querySelectorAll(":scope > .error-text").forEach((old) => old.remove());
  place.after(text);
  const panel = place.closest(".panel");
  if (panel) panel.open = true;
}

function fieldOfKey(root, path) {
  for (let name = path; name; name = name.slice(0, Math.max(0, name.lastIndexOf(".")))) {
    const found = root.querySelector(`[data-key="${CSS.escape(name)}"]`);
    if (found) return found;
  }
  return null;
}

function clearErrors(root) {
  root.querySelectorAll(".invalid").forEach((place) => place.classList.remove("invalid"));
  root.querySelectorAll(".error-text").forEach((text) => text.remove());
}
