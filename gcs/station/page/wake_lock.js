/** Keeps the screen on while a team flies, where the browser can: over https, or on this computer. */

export class WakeLock {
  #isWanted = false;
  #lock = null;

  constructor() {
    document.addEventListener("visibilitychange", () => this.#update()); // a hidden page loses its lock
  }

  /** Keep the screen on, or not. */
  want(isWanted) {
    if (isWanted === this.#isWanted) return;
    this.#isWanted = isWanted;
    this.#update();
  }

  async #update() {
    if (!this.#isWanted) {
      await this.#lock?.release();
      this.#lock = null;
    } else if (document.visibilityState === "visible" && (this.#lock?.released ?? true)) {
      this.#lock = (await navigator.wakeLock?.request("screen").catch(() => null)) ?? null; // refused: its battery is low
    }
  }
}
