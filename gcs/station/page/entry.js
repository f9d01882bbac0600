/**
 * Entry to the station: both ends of a connection prove that they know the secret of its start, the station first.
 * A program that answers in the station's place, now or after its end, is sent no secret and no proof.
 */

import { byId, setText } from "./dom.js";

const KEPT = "cordon-station-secret";
const DERIVATIONS = 600_000;
const NONCE_BYTES = 32;
const ANOTHER =
  "■ This page belongs to an earlier start of the station, or another program answers here. Open the address that cordon printed last.";
const NONE = "Open the address that cordon printed last: it ends with # and the secret of this start.";
const NO_CRYPTOGRAPHY = "This browser cannot prove its access here: open the page at localhost or by https.";

const utf8 = new TextEncoder();

/** The secret of this start, and how the page shows that it has none. */
export class Entry {
  /** @param {function()} changed called when there is another secret or token to try */
  constructor(changed) {
    this.secret = kept();
    this.token = null; // of the user, as a key that scripts cannot read
    this.derived = {}; // from the token, by the salt of a start
    this.ticket = "";
    this.#takeAddress();
    addEventListener("hashchange", () => this.#takeAddress() && changed());
    byId("entry-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#takeToken().then(changed);
    });
  }

  /** The first message on a new connection; `answer` needs it. */
  hello() {
    return { kind: "hello", nonce: hex(crypto.getRandomValues(new Uint8Array(NONCE_BYTES))) };
  }

  /** The answer to a station that has proved that it knows the secret; null for any other. */
  async answer(hello, challenge) {
    if (!crypto.subtle) return this.#refuse(NO_CRYPTOGRAPHY, challenge);
    const message = `${hello.nonce}|${challenge.nonce}`;
    for await (const secret of this.#secrets(challenge)) {
      if ((await proof(secret, `station|${message}`)) !== challenge.proof) continue;
      this.#keep(secret);
      return { kind: "proof", proof: await proof(secret, `page|${message}`) };
    }
    return this.#refuse(this.secret || this.token ? ANOTHER : NONE, challenge);
  }

  /** Take the ticket of this connection. */
  enter({ ticket }) {
    this.ticket = ticket;
    byId("entry").hidden = true;
  }

  /** The headers of requests for files that only pages of this start may read. */
  get headers() {
    return this.ticket ? { Authorization: `Bearer ${this.ticket}` } : {};
  }

  async *#secrets({ salt }) {
    if (this.secret) yield this.secret;
    if (salt && this.token) yield (this.derived[salt] ??= derived(this.token, salt));
  }

  /** Say why the page is not admitted. Only at a server with a certificate the page asks for a user's token. */
  #refuse(text, { salt }) {
    const takesToken = Boolean(salt) && location.protocol === "https:" && Boolean(crypto.subtle);
    byId("entry").hidden = false;
    byId("entry-form").hidden = !takesToken;
    setText(byId("entry-text"), takesToken ? `${text} Or enter the token.` : text);
    return null;
  }

  /** Take the secret behind the # of the address, and remove it there: histories and pictures of the screen keep addresses. */
  #takeAddress() {
    const secret = location.hash.slice(1);
    if (!/^[\w-]{32,}$/.test(secret)) return false;
    this.#keep(secret);
    history.replaceState(null, "", location.pathname);
    return true;
  }

  async #takeToken() {
    const token = byId("entry-token").value.trim();
    byId("entry-token").value = "";
    this.derived = {};
    this.token = await crypto.subtle.importKey("raw", utf8.encode(token), "PBKDF2", false, ["deriveBits"]);
  }

  /** Keep the secret for a reload of this tab. */
  #keep(secret) {
    this.secret = secret;
    try {
      sessionStorage.setItem(KEPT, secret);
    } catch {
      // A browser without storage asks for the address again.
    }
  }
}

function kept() {
  try {
    return sessionStorage.getItem(KEPT) ?? "";
  } catch {
    return "";
  }
}

async function proof(secret, message) {
  const algorithm = { name: "HMAC", hash: "SHA-256" };
  const key = await crypto.subtle.importKey("raw", utf8.encode(secret), algorithm, false, ["sign"]);
  return hex(new Uint8Array(await crypto.subtle.sign("HMAC", key, utf8.encode(message))));
}

async function derived(token, salt) {
  const algorithm = { name: "PBKDF2", hash: "SHA-256", salt: utf8.encode(salt), iterations: DERIVATIONS };
  return hex(new Uint8Array(await crypto.subtle.deriveBits(algorithm, token, 256)));
}

const hex = (bytes) => Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
