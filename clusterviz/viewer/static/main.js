/** The page of `clusterviz view`. */
import {openWebSocket} from "./connection.js";
import {createViewer} from "./viewer.js";

const address = new URL("ws", document.baseURI);
address.protocol = address.protocol.replace("http", "ws");
const viewer = createViewer(document.body, openWebSocket(address.href));
viewer.element.focus();
/** For scripts that measure the page. */
window.clustervizViewer = viewer;
