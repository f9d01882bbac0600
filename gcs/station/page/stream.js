/** The connection to the station: receives pictures, sends command requests. No request is kept to be sent later. */

const RETRY_FIRST_S = 0.5;
const RETRY_LAST_S = 4;

/**
 * Connect, and again whenever the connection ends.
 * @param {string} url of the WebSocket
 * @param {{picture: function(Object), connection: function(boolean)}} handlers
 */
export function openStream(url, handlers) {
  const stream = { socket: null, retry_s: RETRY_FIRST_S };
  connect(stream, url, handlers);
  return {
    /** Send a request now. Return whether the connection is open; otherwise the request is dropped. */
    send(request) {
      if (stream.socket.readyState !== WebSocket.OPEN) return false;
      stream.socket.send(JSON.stringify(request));
      return true;
    },
  };
}

function connect(stream, url, handlers) {
  const socket = new WebSocket(url);
  stream.socket = socket;
  socket.addEventListener("open", () => {
    stream.retry_s = RETRY_FIRST_S;
    handlers.connection(true);
  });
  socket.addEventListener("message", (message) => handlers.picture(JSON.parse(message.data)));
  socket.addEventListener("close", () => {
    handlers.connection(false);
    setTimeout(() => connect(stream, url, handlers), stream.retry_s * 1000);
    stream.retry_s = Math.min(2 * stream.retry_s, RETRY_LAST_S);
  });
}

/** The address of the stream beside this page. */
export function streamUrl() {
  const url = new URL("stream", location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.hash = "";
  return url.href;
}
