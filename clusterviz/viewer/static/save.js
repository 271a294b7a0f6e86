// Panel of what is kept: scene, picture, command line, and the key frames of a camera path.

import {button, formatNumber, labelled, numberInput, parseNumber, showText} from "./controls.js";
import {createElement} from "./elements.js";

const KEY_FRAME_SECONDS = 2;
let saveCount = 0;

/** Offer a file to the user. */
export function downloadFile(name, mediaType, payload) {
  const url = URL.createObjectURL(new Blob([payload], {type: mediaType}));
  const link = createElement("a", {href: url, download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

export class SavePanel {
  constructor(viewer) {
    this.viewer = viewer;
    /** @type {{time: number, camera: any}[]} */
    this.frames = [];
    this.waiting = new Map();
    this.result = createElement("div", {class: "note", "aria-live": "polite"});
    this.list = createElement("div", {class: "key-frames"});
    this.list.dataset.key = "path";
    this.element = createElement("div", {}, this.sceneRow(), this.pictureRow(), this.result, this.pathRows());
    viewer.on("file", ({header, payload}) => this.take(header, payload));
    viewer.on("error", (message) => this.refuse(message));
    this.showFrames();
  }

  show(state) {
    const [width, height] = state.scene.image.size;
    showText(this.width, this.width.value || String(width));
    showText(this.height, this.height.value || String(height));
  }

  /** Ask for a file. */
  ask(what, more = {}, react = null) {
    saveCount += 1;
    this.waiting.set(saveCount, react);
    this.result.textContent = what === "picture" ? "Drawing the picture…" : "";
    this.viewer.send({type: "save", what, save: saveCount, ...more});
  }

  take(header, payload) {
    if (!this.waiting.has(header.save)) return;
    const react = this.waiting.get(header.save);
    this.waiting.delete(header.save);
    this.result.textContent = react ? "" : `Saved ${header.name}`;
    if (react) react(new TextDecoder().decode(payload));
    else downloadFile(header.name, header.media_type, payload);
  }

  refuse(message) {
    const isMine = this.waiting.delete(message.save) || (this.waiting.size && message.message.startsWith("save: "));
    if (isMine) this.result.textContent = message.message;
  }

  sceneRow() {
    const scene = button("Scene (YAML)", () => this.ask("scene"), {title: "A scene file that draws this picture"});
    const copy = button("Copy command", () => this.ask("command", {}, (text) => this.copy(text)));
    copy.title = "Copy the command line that makes this picture";
    return createElement("div", {class: "row"}, scene, copy);
  }

  /** Put a text on the clipboard, or show it where the browser refuses. */
  async copy(text) {
    try {
      await navigator.clipboard.writeText(text);
      this.result.textContent = `Copied: ${text}`;
    } catch {
      const field = createElement("textarea", {rows: 4, readonly: true, "aria-label": "Command line"});
      field.value = text;
      this.result.replaceChildren(field);
      field.select();
    }
  }

  pictureRow() {
    const side = (title) => numberInput(() => undefined, {title});
    [this.width, this.height] = [side("width"), side("height")];
    const size = () => ({width: parseNumber(this.width.value), height: parseNumber(this.height.value)});
    const save = button("Picture", () => this.ask("picture", size()), {title: "This picture in any size"});
    const row = labelled("Size", this.width, this.height, save);
    row.classList.add("vector");
    row.dataset.key = "save";
    return row;
  }

  pathRows() {
    const add = button("Add this view", () => this.add(), {title: "Add the present view as a key frame"});
    this.play = button("Play", () => this.startPath(), {title: "Move along the path"});
    this.savePath = button("Save path", () => this.ask("path", {keys: this.frames}));
    this.savePath.title = "A file for clusterviz animate --path";
    const row = createElement("div", {class: "row"}, add, this.play, this.savePath);
    return createElement("div", {}, createElement("div", {class: "subtitle"}, "Camera path"), this.list, row);
  }

  add() {
    const last = this.frames[this.frames.length - 1];
    const camera = structuredClone(this.viewer.camera ?? this.viewer.state.scene.camera);
    this.setFrames([...this.frames, {time: last ? last.time + KEY_FRAME_SECONDS : 0, camera: fiveKeys(camera)}]);
  }

  setFrames(frames) {
    this.frames = [...frames].sort((a, b) => a.time - b.time);
    this.viewer.setPath(this.frames);
    this.showFrames();
  }

  startPath() {
    this.viewer.setPath(this.frames);
    this.viewer.play();
  }

  showFrames() {
    this.list.replaceChildren(...this.frames.map((frame, index) => this.frameRow(frame, index)));
    this.play.disabled = this.savePath.disabled = this.frames.length < 2;
  }

  frameRow(frame, index) {
    const time = numberInput((value) => this.setTime(index, value), {title: "time, seconds"});
    time.value = formatNumber(frame.time);
    const go = button("go", () => this.viewer.moveTo(frame.camera), {title: "Move to this view"});
    const update = button("set", () => this.update(index), {title: "Take the present view for this key frame"});
    const up = button("↑", () => this.swap(index - 1), {title: "Earlier", class: "icon"});
    const down = button("↓", () => this.swap(index), {title: "Later", class: "icon"});
    const drop = () => this.setFrames(this.frames.toSpliced(index, 1));
    const remove = button("✕", drop, {title: "Remove", class: "icon"});
    [up.disabled, down.disabled] = [index === 0, index === this.frames.length - 1];
    const label = createElement("span", {class: "label"}, `Key ${index + 1}`);
    return createElement("div", {class: "row key-frame"}, label, time, "s", go, update, up, down, remove);
  }

  setTime(index, value) {
    const isTaken = this.frames.some((frame, other) => other !== index && frame.time === value);
    const changed = {...this.frames[index], time: value};
    if (Number.isFinite(value) && !isTaken) this.setFrames(this.frames.with(index, changed));
    else this.showFrames();
  }

  update(index) {
    this.setFrames(this.frames.with(index, {...this.frames[index], camera: fiveKeys(this.viewer.camera)}));
  }

  /** Exchange the views of two consecutive key frames; their times stay. */
  swap(index) {
    const [a, b] = [this.frames[index], this.frames[index + 1]];
    this.setFrames(this.frames.with(index, {...a, camera: b.camera}).with(index + 1, {...b, camera: a.camera}));
  }
}

function fiveKeys({position, focal_point, view_up, view_angle, parallel_scale = null}) {
  return {position, focal_point, view_up, view_angle, parallel_scale};
}
