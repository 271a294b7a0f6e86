/** The side bar. */
import {createElement} from "./elements.js";

/** @type {(viewer: import("./viewer.js").Viewer) => HTMLElement} */
export function createPanels(viewer) {
  const panels = createElement("div", {class: "panels"});
  const paragraph = (text) => createElement("p", {}, text);
  viewer.on("state", ({warnings}) => panels.replaceChildren(...(warnings ?? []).map(paragraph)));
  return panels;
}
