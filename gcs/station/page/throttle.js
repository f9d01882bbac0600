/** Limits how often a function is called; the last value always reaches it. */

/** @param {number} period_ms @param {function(*)} act */
export function atMostEvery(period_ms, act) {
  const state = { timer: null, last_ms: -Infinity, value: undefined };
  const run = () => {
    state.timer = null;
    state.last_ms = performance.now();
    act(state.value);
  };
  return (value) => {
    state.value = value;
    if (state.timer !== null) return;
    const wait_ms = state.last_ms + period_ms - performance.now();
    if (wait_ms <= 0) run();
    else state.timer = setTimeout(run, wait_ms);
  };
}
