// A recording in place of a running mission: its time goes on, stands still or is set, for everyone who looks at it.

import { send } from "./net.js";
import { $, attempt, now, rewrite, state } from "./state.js";
import { elapsed } from "./words.js";

const KEYS_S = { ArrowLeft: -60, ArrowRight: 60, ArrowDown: -60, ArrowUp: 60, PageDown: -3600, PageUp: 3600 };
const FASTER = 10; // with Shift
const NORMAL = "60";
let sending = false, wanted = null; // the time that is asked for next [s]
let held = false; // the slider is in the operator's hand

const isShown = () => state.recording !== null;
const atS = () => Math.min(state.recording.length_s, Math.max(0, (now() - state.recording.begin_ns) / 1e9));

export function takeRecording(recording) {
  state.recording = recording;
  document.body.classList.toggle("replaying", isShown());
  $("replay").hidden = !isShown();
  if (!isShown()) return;
  $("replay-time").max = Math.ceil(recording.length_s); // its last second is a whole one
  if (recording.pace > 0) $("replay-pace").value = nearest(recording.pace);
  rewrite($("replay-note"), recording.notes.join("; "));
  showRecording();
}

// The slider and the words beside it, as time goes on.
export function showRecording() {
  if (!isShown() || !state.clock) return;
  const at = held || wanted !== null ? Number($("replay-time").value) : atS();
  const plays = state.clock.rate > 0, ended = at >= state.recording.length_s - 1;
  const text = `${elapsed(at)} of ${elapsed(state.recording.length_s).slice(3)}`;
  if (!held && wanted === null) $("replay-time").value = Math.floor(at);
  $("replay-time").setAttribute("aria-valuetext", text);
  rewrite($("replay-at"), text);
  rewrite($("replay-play"), plays ? "Pause" : ended ? "Play again" : "Play");
}

const nearest = (pace) => {
  const values = [...$("replay-pace").options].map((option) => option.value);
  return values.reduce((best, value) => (Math.abs(Math.log(value / pace)) < Math.abs(Math.log(best / pace)) ? value : best), NORMAL);
};

const change = (document) => attempt(() => send("recording", document));

// One jump at a time; of those that are asked for meanwhile, the last.
async function jump(seconds) {
  wanted = seconds;
  if (sending) return;
  sending = true;
  while (wanted !== null) {
    const asked = wanted;
    await change({ at_s: Math.min(asked, state.recording.length_s) });
    if (wanted === asked) wanted = null;
  }
  sending = false;
}

$("replay-time").addEventListener("input", () => { held = true; jump(Number($("replay-time").value)); showRecording(); });
$("replay-time").addEventListener("change", () => { held = false; });
$("replay-time").addEventListener("keydown", (event) => {
  const step = KEYS_S[event.key];
  if (step === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  const slider = $("replay-time");
  slider.value = Number(slider.value) + step * (event.shiftKey ? FASTER : 1);
  jump(Number(slider.value));
  showRecording();
});
$("replay-play").addEventListener("click", () => {
  const plays = state.clock.rate > 0, ended = atS() >= state.recording.length_s - 1;
  change({ pace: plays ? 0 : Number($("replay-pace").value), ...(!plays && ended ? { at_s: 0 } : {}) });
});
$("replay-pace").addEventListener("change", () => { if (state.clock.rate > 0) change({ pace: Number($("replay-pace").value) }); });
