/** The connection to the station: receives pictures, sends command requests. No request is kept to be sent later. */

import { Entry } from "./entry.js";

const RETRY_FIRST_S = 0.5;
const RETRY_LAST_S = 4;

/** Connects and enters, and again whenever the connection ends. */
export class Stream {
  /**
   * @param {string} url of the WebSocket
   * @param {{picture: function(Object), connection: function(boolean)}} handlers
   */
  constructor(url, handlers) {
    Object.assign(this, { url, handlers, retry_s: RETRY_FIRST_S, hasEntered: false });
    this.entry = new Entry(() => this.#again());
    this.#connect();
  }

  /** Send a request now. Return whether the page has entered; otherwise the request is dropped. */
  send(request) {
    if (!this.hasEntered || this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(request));
    return true;
  }

  /** Request JSON that only pages of this start may read. Return null, and connect again, where it does not arrive. */
  async fetch(url) {
    try {
      return await (await fetch(url, { headers: this.entry.headers })).json();
    } catch {
      this.socket.close();
      return null;
    }
  }

  #connect() {
    const socket = new WebSocket(this.url);
    const hello = this.entry.hello();
    const enter = (entered) => {
      this.#enter(entered);
      handle = this.handlers.picture;
    };
    let handle = async (challenge) => {
      if (await this.#prove(socket, hello, challenge)) handle = enter;
    };
    this.socket = socket;
    socket.addEventListener("open", () => socket.send(JSON.stringify(hello)));
    socket.addEventListener("message", (message) => handle(JSON.parse(message.data)));
    socket.addEventListener("close", () => {
      this.hasEntered = false;
      this.handlers.connection(false);
      this.timer = setTimeout(() => this.#connect(), this.retry_s * 1000);
      this.retry_s = Math.min(2 * this.retry_s, RETRY_LAST_S);
    });
  }

  /** Answer a station's challenge, and leave a program that has not proved to be this station. */
  async #prove(socket, hello, challenge) {
    const answer = await this.entry.answer(hello, challenge);
    if (answer && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(answer));
    else socket.close();
    return Boolean(answer);
  }

  #enter(entered) {
    this.entry.enter(entered);
    this.retry_s = RETRY_FIRST_S;
    this.hasEntered = true;
    this.handlers.connection(true);
  }

  /** Try another secret at once. */
  #again() {
    clearTimeout(this.timer);
    this.retry_s = RETRY_FIRST_S;
    if (this.socket.readyState === WebSocket.CLOSED) this.#connect();
    else this.socket.close();
  }
}

/** The address of the stream beside this page. */
export function streamUrl() {
  const url = new URL("stream", location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.hash = "";
  return url.href;
}
