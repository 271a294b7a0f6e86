/** Buttons over the view: fit, views along the axes, projection, flight, side bar, help. */
import {createElement, createIcon} from "./elements.js";

const ICONS = {
  fit: "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4M6 6h4v4H6z",
  views: "M8 1.5 14 5v6.5L8 14.5 2 11.5V5zM2 5l6 3.2L14 5M8 8.2v6.3",
  perspective: "M2.5 3 13.5 5v6l-11 2zM6 3.7v8.7M10 4.4v7.2",
  parallel: "M2.5 3h11v10h-11zM6.2 3v10M9.8 3v10",
  fly: "M14 2 2 7.5l4.5 2L9 14z",
  sidebar: "M2 3h12v10H2zM10 3v10",
  help: "M5.8 6a2.2 2.2 0 1 1 3 2.1c-.6.3-.8.7-.8 1.4M8 11.9v.4",
};
const VIEW_NAMES = ["front", "back", "left", "right", "top", "bottom"];

/** @typedef {{element: HTMLElement, update: () => void}} Part of the page; update shows the viewer's present state */

/** @type {(actions: Record<string, () => void>, read: () => {orientation: string, parallel: boolean, flying: boolean,
 *   sidebar: boolean}, label: (name: string) => string) => Part}
 * label: what a named view is called for the data at hand */
export function createToolbar(actions, read, label) {
  const button = (name, title, key) => createElement(
    "button", {type: "button", title: `${title} (${key})`, "aria-label": title, onclick: () => actions[name]()},
    createIcon(ICONS[name] ?? ICONS.perspective),
  );
  const fit = button("fit", "Fit everything", "R");
  const projection = button("projection", "Parallel projection", "O");
  const fly = button("fly", "Fly", "F");
  const sidebar = button("sidebar", "Side bar", "B");
  const help = button("help", "Help", "?");
  const choose = (name) => { menu.open = false; actions[name](); };
  const views = VIEW_NAMES.map((name, i) => createElement(
    "button", {type: "button", title: `Key ${i + 1}`, onclick: () => choose(name)},
  ));
  const labels = {title: "Views", "aria-label": "Views"};
  const summary = createElement("summary", labels, createIcon(ICONS.views));
  const menu = createElement("details", {class: "menu"}, summary, createElement("div", {}, ...views));
  menu.addEventListener("focusout", (event) => { if (!menu.contains(event.relatedTarget)) menu.open = false; });
  menu.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    menu.open = false;
    summary.focus();
  });
  const element = createElement(
    "div", {class: "toolbar", role: "group", "aria-label": "View"}, fit, menu, projection, fly, help, sidebar,
  );

  function update() {
    const {parallel, flying, sidebar: open} = read();
    projection.setAttribute("aria-pressed", parallel);
    projection.querySelector("path").setAttribute("d", parallel ? ICONS.parallel : ICONS.perspective);
    fly.setAttribute("aria-pressed", flying);
    sidebar.setAttribute("aria-expanded", open);
    views.forEach((view, i) => { view.textContent = label(VIEW_NAMES[i]); });
  }

  return {element, update};
}
