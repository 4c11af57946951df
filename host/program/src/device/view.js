// The live view: asks for the last reconstruction and its figures.
"use strict";
let last = -1, lost = 0;
const stream = document.getElementById("stream"), numbers = document.getElementById("numbers");
const say = (text, bad) => { stream.textContent = text; stream.className = bad ? "bad" : ""; };
async function look() {
  let text = null;
  try {
    text = await (await fetch("/state")).text();
    lost = 0;
  } catch {
    // The program serves this page: when it has ended, nobody answers.
    lost += 1;
    if (lost > 5) say(last < 0 ? "stream ended before its first frame" : `stream ended after frame ${last}`, true);
  }
  if (text) {
    const state = JSON.parse(text);
    if (state.frame !== last) {
      last = state.frame;
      document.getElementById("picture").src = "/frame.png?n=" + last;
      numbers.textContent = `Frame ${state.frame} at ${state.seconds.toFixed(1)} s; ${state.dropped} dropped so far, `
        + `${state.dropped_before} just before; ${state.saturated_px} pixels saturated; white is ${state.max.toFixed(3)}; `
        + (state.exact ? "exact." : `approximate, statistics of the field held from frame ${state.field_frame}.`);
      numbers.className = state.dropped_before > 0 ? "bad" : "";
    }
    say(state.ended ? `stream ended after frame ${last}` : "live", state.ended);
  }
  setTimeout(look, lost > 5 ? 1000 : 100);
}
look();
