/** Elements of the page, made without templates. */

/** @type {(tag: string, attributes?: Record<string, any>, ...children: (Node | string)[]) => HTMLElement}
 * attributes: names that start with "on" are listeners, booleans switch an attribute on or off */
export function createElement(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  setAttributes(element, attributes);
  element.append(...children);
  return element;
}

function setAttributes(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (typeof value === "boolean") element.toggleAttribute(name, value);
    else element.setAttribute(name, value);
  }
}

/** Icon of 16 × 16 units, drawn as lines. @type {(path: string) => SVGElement} */
export function createIcon(path) {
  const namespace = "http://www.w3.org/2000/svg";
  const icon = document.createElementNS(namespace, "svg");
  const line = document.createElementNS(namespace, "path");
  setAttributes(icon, {viewBox: "0 0 16 16", class: "icon", "aria-hidden": "true"});
  setAttributes(line, {d: path});
  icon.append(line);
  return icon;
}
