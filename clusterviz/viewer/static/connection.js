/**
 * Websocket that connects again after it is lost.
 *
 * @typedef {{state: "open" | "lost" | "closed", attempt: number, seconds: number}} ConnectionStatus
 *   attempt: number of the attempt that follows in `seconds`
 * @typedef {object} Connection
 * @property {(message: object) => void} send dropped while there is no connection
 * @property {(f: (message: object) => void) => void} onText
 * @property {(f: (data: ArrayBuffer | ArrayBufferView) => void) => void} onBinary
 * @property {(f: () => void) => void} onClose the connection is lost for ever
 * @property {(f: (status: ConnectionStatus) => void) => void} [onStatus]
 * @property {() => void} [retry] connect now
 * @property {() => void} close
 */

const RETRY_SECONDS = [0.5, 1, 2, 4, 5, 5, 5, 5, 5, 5];
const PING_SECONDS = 5;
/** A connection on which nothing arrived for so long is taken as lost, seconds. */
const SILENCE_SECONDS = 30;

/** @type {(url: string) => Connection} */
export function openWebSocket(url) {
  const listeners = {text: () => {}, binary: () => {}, close: () => {}, status: () => {}};
  let socket = null;
  let attempt = 0;
  let closed = false;
  let timer = 0;
  let heard = 0;

  function connect() {
    clearTimeout(timer);
    socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    socket.onopen = opened;
    socket.onmessage = received;
    socket.onclose = lost;
  }

  function opened() {
    heard = performance.now();
    listeners.status({state: "open", attempt: 0, seconds: 0});
    timer = setTimeout(ping, PING_SECONDS * 1000);
  }

  function received({data}) {
    heard = performance.now();
    if (typeof data === "string") listeners.text(JSON.parse(data));
    else listeners.binary(data);
  }

  function ping() {
    if (performance.now() - heard > SILENCE_SECONDS * 1000) {
      abandon();
      lost();
      return;
    }
    attempt = 0; // only now: a server that closes each connection at once must not be asked in haste
    send({type: "ping", time: performance.now()});
    timer = setTimeout(ping, PING_SECONDS * 1000);
  }

  function lost() {
    clearTimeout(timer);
    if (closed) return;
    const seconds = RETRY_SECONDS[attempt];
    if (seconds === undefined) {
      attempt = 0;
      listeners.status({state: "closed", attempt, seconds: 0});
      listeners.close();
      return;
    }
    attempt += 1;
    listeners.status({state: "lost", attempt, seconds});
    timer = setTimeout(connect, seconds * 1000);
  }

  /** Close the socket without hearing of it: closing a dead connection takes minutes. */
  function abandon() {
    socket.onopen = socket.onmessage = socket.onclose = null;
    socket.close();
  }

  function send(message) {
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  }

  connect();
  return {
    send,
    onText: (f) => { listeners.text = f; },
    onBinary: (f) => { listeners.binary = f; },
    onClose: (f) => { listeners.close = f; },
    onStatus: (f) => { listeners.status = f; },
    retry: () => { abandon(); connect(); },
    close: () => { closed = true; clearTimeout(timer); abandon(); },
  };
}
