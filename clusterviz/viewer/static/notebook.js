/** The viewer in a cell of a notebook, as anywidget shows it: messages go through the widget's model. */
import {createViewer} from "./viewer.js";

const HEARTBEAT_SECONDS = 20;
/** Width of a cell that has room for the settings, CSS pixels. */
const ROOM_FOR_SIDEBAR = 900;

/**
 * Messages between a view and the session in the kernel. Each view of a widget has a name of its own.
 *
 * @param {object} model of anywidget
 * @returns {import("./connection.js").Connection}
 */
function connectModel(model) {
  const view = Array.from(crypto.getRandomValues(new Uint32Array(4)), (word) => word.toString(16)).join("");
  const listeners = {text: () => {}, binary: () => {}, close: () => {}, status: () => {}};
  const received = (content, buffers) => {
    if (content.view !== view) return;
    if (content.text) listeners.text(JSON.parse(content.text));
    else if (content.closed) listeners.close();
    else listeners.binary(buffers[0]);
  };
  const send = (message) => model.send({view, text: JSON.stringify(message)});
  const timer = setInterval(() => send({type: "ping", time: performance.now()}), HEARTBEAT_SECONDS * 1000);
  const lost = () => listeners.close();

  model.on("msg:custom", received);
  // The kernel has gone or was started again.
  model.on("comm_live_update", lost);
  model.send({view, joins: true});
  return {
    send,
    onText: (f) => { listeners.text = f; },
    onBinary: (f) => { listeners.binary = f; },
    onClose: (f) => { listeners.close = f; },
    close: () => {
      clearInterval(timer);
      model.off("msg:custom", received);
      model.off("comm_live_update", lost);
      model.send({view, leaves: true});
    },
  };
}

function render({model, el}) {
  // The style of `el` belongs to the layout of ipywidgets.
  const box = el.appendChild(document.createElement("div"));
  const resize = () => { box.style.height = `${model.get("height")}px`; };
  resize();
  model.on("change:height", resize);
  const viewer = createViewer(box, connectModel(model));
  if (box.clientWidth < ROOM_FOR_SIDEBAR) {
    viewer.element.classList.add("without-sidebar");
    viewer.toolbar.update();
  }
  return () => {
    model.off("change:height", resize);
    viewer.destroy();
    box.remove();
  };
}

export default {render};
