/** Line under the view: rate, time, what is shown, ranks, who steers, connection. */
import {createElement} from "./elements.js";

const CONNECTION_TEXT = {open: "connected", lost: "connecting…", closed: "ended"};

export class StatusLine {
  constructor() {
    this.connection = "open";
    this.times = [];
    this.latency = null;
    this.header = null;
    const names = ["motion", "rate", "time", "size", "ranks", "steering", "connection"];
    this.parts = Object.fromEntries(names.map((name) => [name, createElement("span", {class: `status-${name}`})]));
    this.element = createElement("footer", {class: "status"}, ...Object.values(this.parts));
  }

  /** @param {import("./picture.js").PictureHeader} header @param {?number} latency milliseconds */
  pictureShown(header, latency) {
    this.header = header;
    this.latency = latency ?? this.latency;
    this.times.push(performance.now());
  }

  /** @returns {number} pictures shown within the last second */
  get rate() {
    const now = performance.now();
    this.times = this.times.filter((time) => time > now - 1000);
    return this.times.length;
  }

  /** @param {?object} hello @param {?object} state @param {number} input newest input of this client */
  update(hello, state, input) {
    const {header, latency, rate} = this;
    const moving = header !== null && !header.still;
    const drawing = header !== null && header.still && header.input < input;
    const motion = drawing ? "drawing" : moving ? "moving" : "still";
    this.write("motion", header ? motion : "waiting for the first picture");
    this.element.classList.toggle("moving", moving || drawing);
    this.write("rate", moving ? `${rate} frames/s` : "");
    this.write("time", header ? timeText(header, latency) : "");
    this.write("size", header ? `${header.width} × ${header.height}` : "");
    this.write("ranks", hello ? `${hello.ranks} ${hello.ranks === 1 ? "rank" : "ranks"}` : "");
    this.write("steering", steeringText(hello, state));
    this.write("connection", CONNECTION_TEXT[this.connection]);
    this.element.dataset.connection = this.connection;
  }

  write(name, text) {
    if (this.parts[name].textContent !== text) this.parts[name].textContent = text;
    this.parts[name].hidden = !text;
  }
}

function timeText({still, seconds}, latency) {
  if (still) return `rendered in ${seconds < 1 ? `${Math.round(seconds * 1000)} ms` : `${seconds.toFixed(2)} s`}`;
  return `${Math.round(latency ?? seconds * 1000)} ms`;
}

function steeringText(hello, state) {
  if (!hello || !state || (state.clients?.length ?? 1) < 2) return "";
  if (state.steering === hello.client) return "you steer";
  return state.steering === null ? "nobody steers" : `client ${state.steering} steers`;
}
