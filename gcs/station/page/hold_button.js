/** A button that acts when it has been held for a second, by pointer or by key: a short press does nothing. */

const HOLD_MS = 1000;
const FRAME_MS_MAX = 100; // while the page stands still, holding does not count
const KEYS = ["Enter", " "];

/**
 * @param {HTMLButtonElement} button
 * @param {function()} act called once for each time that the button was held
 */
export function actWhenHeld(button, act) {
  const hold = { held_ms: null, last_ms: 0, frame: 0 };
  const begin = () => {
    hold.held_ms ??= 0;
    hold.last_ms = performance.now();
    hold.frame = requestAnimationFrame((now_ms) => count(button, hold, now_ms, act));
  };
  const cancel = () => {
    hold.held_ms = null;
    cancelAnimationFrame(hold.frame); // a press before the next frame would be counted twice
    show(button, 0);
  };
  beginWith(button, hold, begin);
  for (const end of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) button.addEventListener(end, cancel);
  document.addEventListener("visibilitychange", cancel);
  button.addEventListener("contextmenu", (event) => event.preventDefault()); // the menu of a long touch
}

function beginWith(button, hold, begin) {
  const beginOnce = () => hold.held_ms === null && begin();
  button.addEventListener("pointerdown", (event) => event.isPrimary && event.button === 0 && beginOnce());
  button.addEventListener("keydown", (event) => KEYS.includes(event.key) && !event.repeat && beginOnce());
}

function count(button, hold, now_ms, act) {
  if (hold.held_ms === null || button.disabled) return;
  hold.held_ms += Math.min(Math.max(now_ms - hold.last_ms, 0), FRAME_MS_MAX);
  hold.last_ms = now_ms;
  show(button, Math.min(hold.held_ms / HOLD_MS, 1));
  if (hold.held_ms < HOLD_MS) {
    hold.frame = requestAnimationFrame((next_ms) => count(button, hold, next_ms, act));
    return;
  }
  hold.held_ms = Infinity; // until it is released
  act();
}

const show = (button, share) => button.style.setProperty("--held", String(share));

/** Keep held keys from pressing a button again and again. */
export function ignoreKeyRepeat(root) {
  root.addEventListener(
    "keydown",
    (event) => event.repeat && KEYS.includes(event.key) && event.target.closest("button, input") && event.preventDefault(),
    { capture: true },
  );
}
