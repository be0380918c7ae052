// What the timeline shows, from what the page knows: rounds as planned and as flown, what the rover did, commands, contacts,
// alarms. Pure: values in, values out. Times are seconds since the mission's beginning.

import { duration, elapsed, words } from "./words.js";

const WORKS = { driving: "good", drilling: "accent", analysing: "accent2", charging: "warn", paused: "dim", parked: "dim", idle: "dim", safe: "bad" };
const ENDS = new Set(["round_completed", "round_aborted"]);
const MARKED = new Set(["blocked", "safe_mode_entered", "low_energy", "plan_rejected", "sample_skipped", "instrument_silent"]);
const ROWS = 3; // of items that overlap; further ones lie over each other

// The facts on the axis of the mission's time. now_s, and heard_s of the newest word of the rover, are null while not known.
export function moments({ start_ns, now_ns, heard_ns, ...facts }) {
  const at = (ns) => (ns - start_ns) / 1e9;
  return { ...facts, at, now_s: now_ns === null ? null : at(now_ns), heard_s: heard_ns ? at(heard_ns) : null };
}

export function lanes(facts) {
  return [
    { name: "Rounds", rows: 2, items: [...planned(facts), ...flown(facts)] },
    { name: "Rover", rows: 1, items: rover(facts) },
    { name: "Commands", rows: ROWS, items: stacked(commands(facts)) },
    { name: "Contact", rows: 1, items: contacts(facts) },
    { name: "Alarms", rows: ROWS, items: stacked(alarms(facts)) },
  ];
}

const end = ({ now_s, heard_s }) => now_s ?? heard_s ?? 0;
const byTime = (events) => [...events].sort((a, b) => a.at - b.at);

// The expected times of each round: those of its newest plan.
export function plans({ entries, at }) {
  const found = new Map();
  for (const { kind, round, begins_at, ends_at } of entries) {
    if (kind === "plan" && ends_at) found.set(round, { round, from: at(begins_at), to: at(ends_at) });
  }
  return found;
}

function planned(facts) {
  const { proposal, now_s } = facts, sent = [...plans(facts).values()].map(planItem);
  if (!proposal || proposal.lasts_s === null || now_s === null) return sent;
  const { plan: { round }, lasts_s } = proposal, from = Math.max(now_s, ...sent.map(({ to }) => to));
  return [...sent, { from, to: from + lasts_s, row: 0, look: "proposed", label: `${round}`, text: `round ${round} waits for approval, ${duration(lasts_s)}` }];
}

const planItem = ({ round, from, to }) => ({ from, to, row: 0, look: "planned", label: `${round}`, text: `round ${round} as planned, ${duration(to - from)}` });

function flown({ events, at, ...facts }) {
  const found = [];
  let open = null;
  for (const event of byTime(events)) {
    if (event.kind === "round_started" || ENDS.has(event.kind)) {
      if (open) { open.to = at(event.at); open.open = false; }
      if (open && event.kind === "round_aborted") { open.look = "bad"; open.text += ", aborted"; }
      open = null;
    }
    if (event.kind === "round_started") {
      open = { from: at(event.at), to: Math.max(facts.heard_s ?? 0, at(event.at)), row: 1, look: "good", label: `${event.round}`, round: event.round, open: true, text: `round ${event.round} as flown` };
      found.push(open);
    }
  }
  return found;
}

function rover({ modes, samples, events, at, heard_s }) {
  const spans = modes.map(({ mode, made_at }, index) => {
    const from = at(made_at), next = modes[index + 1];
    const to = next ? at(next.before_at ?? next.made_at) : Math.max(heard_s ?? from, from);
    return { from, to, look: WORKS[mode] ?? "dim", label: "", text: `${mode} for ${duration(to - from)}`, open: !next };
  });
  const silent = modes.filter(({ before_at }) => before_at).map(({ before_at, made_at }) => ({ from: at(before_at), to: at(made_at), look: "unknown", label: "", text: `no report of what the rover did for ${duration((made_at - before_at) / 1e9)}` }));
  const taken = samples.map(({ sample_id, measured_at, helium3_ppb }) => ({ from: at(measured_at), to: at(measured_at), tick: "sample", text: `sample ${sample_id}: ${helium3_ppb.toFixed(2)} ppb` }));
  const marked = events.filter(({ kind }) => MARKED.has(kind)).map((event) => ({ from: at(event.at), to: at(event.at), tick: "bad", text: `${words(event.kind)}${event.detail ? `: ${event.detail}` : ""}` }));
  return [...spans, ...silent, ...taken, ...marked];
}

function commands({ commands: known, preview, at, ...facts }) {
  return [...previewed(preview, at, facts.now_s), ...known.map(({ command, stages, end: over, by }) => {
    const from = at(stages[0]?.at ?? 0), last = stages.at(-1), done = over ?? last?.stage ?? "queued";
    const look = over === "completed" ? "good" : over ? "bad" : "accent";
    const passed = stages.map((stage) => `${stage.stage} +${duration((stage.at - stages[0].at) / 1e9)}`).join(", ");
    return { from, to: over ? at(last.at) : Math.max(end(facts), from), look, open: !over, label: words(command.kind), stages: stages.map((stage) => at(stage.at)), text: `${words(command.kind)}${by ? ` by ${by}` : ""}: ${done}; ${passed}` };
  })];
}

// A command that is looked at before it is sent: when the rover can have it, and when word of it can be back.
function previewed(preview, at, now_s) {
  if (!preview?.received_at || now_s === null) return [];
  const on = at(preview.received_at), back = preview.word_back_at ? at(preview.word_back_at) : on, kind = words(preview.command.kind);
  return [{ from: now_s, to: back, look: "proposed", label: `${kind}?`, stages: [on], text: `${kind}, if it is sent now: on the rover in ${duration(on - now_s)}, word back in ${duration(back - now_s)} at the earliest` }];
}

function contacts({ contacts: known, at, now_s }) {
  if (!known) return [];
  const found = [];
  let open = null;
  const close = (to) => { if (open) found.push({ ...open, to, text: open.look === "contact" ? `contact for ${duration(to - open.from)}` : `no contact for ${duration(to - open.from)}${open.by}` }); };
  for (const event of known.events) {
    const from = at(event.at), look = event.contact ? "contact" : "none";
    if (event.what) found.push({ from, to: from, tick: "accent", text: `link: ${event.what}${event.by ? ` by ${event.by}` : ""}` });
    if (open?.look === look) continue;
    close(from);
    open = { from, look, label: "", by: event.what && !event.contact ? `: ${event.what}` : "" };
  }
  if (open && now_s !== null) close(Math.max(now_s, open.from));
  for (const [opens, closes] of now_s === null ? [] : known.ahead) {
    const from = Math.max(at(opens), now_s), to = closes === null ? Infinity : at(closes);
    found.push({ from, to, look: "ahead", label: "", text: closes === null ? "contact, no end is known" : `contact to come, for ${duration(to - from)}` });
  }
  return found;
}

function alarms({ alarms: known, at, ...facts }) {
  return [...known.history, ...known.current].map(({ kind, severity, raised_at, ended_at, text, acknowledged_by }) => {
    const from = at(raised_at), seen = acknowledged_by ? `, acknowledged by ${acknowledged_by}` : "";
    return { from, to: ended_at ? at(ended_at) : Math.max(end(facts), from), look: severity, open: !ended_at, label: words(kind), text: `${words(kind)} (${severity}): ${text}${seen}` };
  });
}

// Items that overlap in rows of their own, as far as there are rows.
function stacked(items) {
  const free = new Array(ROWS).fill(-Infinity);
  return items.sort((a, b) => a.from - b.from).map((item) => {
    const row = Math.max(0, free.findIndex((to) => to <= item.from));
    free[row] = Math.max(free[row], item.to);
    return { ...item, row };
  });
}

// Where the label of an item begins that stands upright nowhere else: in the first gap of its item that is wide enough, or
// behind the item; null for nowhere. item: from and to, and taken what is on its row already, each [from, to]; a line that
// crosses the row has both the same. All are pixels; needs: the label's width, with what is left free around it.
export function labelPlace([from, to], needs, taken, [first, last]) {
  const free = (left) => left >= first && left + needs <= last && !taken.some(([a, b]) => a < left + needs && b > left);
  const begins = [Math.max(from, first), ...taken.map(([, b]) => b).sort((a, b) => a - b)];
  const within = begins.find((left) => left >= from && left + needs <= to && free(left));
  if (within !== undefined) return { left: within, within: true };
  return free(to) ? { left: to, within: false } : null;
}

// How far the rover is behind its plan, by what light allows to know: { round, behind_s, as_of_s }; null without a plan.
export function deviation(facts) {
  const known = plans(facts), rounds = flown(facts).filter(({ round }) => known.has(round));
  const last = rounds.at(-1);
  if (!last) return null;
  const late = ({ round, to }) => to - known.get(round).to;
  if (!last.open) return { round: last.round, behind_s: late(last), as_of_s: last.to };
  // The round under way is late as soon as it should be over; until then it is as late as it began.
  const began = last.from - known.get(last.round).from;
  return { round: last.round, behind_s: Math.max(began, late(last)), as_of_s: last.to };
}

export function deviationText(facts) {
  const found = deviation(facts);
  if (!found) return "no plan to compare with yet";
  const { round, behind_s, as_of_s } = found;
  const how = Math.abs(behind_s) < 60 ? "on time" : `${duration(Math.abs(behind_s))} ${behind_s > 0 ? "behind plan" : "ahead of plan"}`;
  return `round ${round}: ${how}, as of ${elapsed(as_of_s)}`;
}

export function contactText({ contacts: known, at, now_s }) {
  if (!known || now_s === null) return "contact not known";
  const next = known.ahead[0];
  if (!next) return "no contact, no end is known";
  const opens = at(next[0]), closes = next[1] === null ? null : at(next[1]);
  if (opens > now_s) return `next contact in ${duration(opens - now_s)}, at ${elapsed(opens)}`;
  return closes === null ? "in contact, no end is known" : `in contact for another ${duration(Math.max(0, closes - now_s))}`;
}

// What was at that moment, in words; of each lane at most three things.
export function described(shown, at_s) {
  const found = shown.map(({ items }) => items.filter(({ from, to, tick }) => !tick && from <= at_s && at_s < to).slice(-3).map(({ text }) => text).join("; "));
  return found.filter(Boolean).join(" · ") || "nothing known";
}

// The moments at which something begins or ends, in order.
export function edges(shown) {
  const found = shown.flatMap(({ items }) => items.flatMap(({ from, to }) => [from, to]));
  return [...new Set(found.filter(Number.isFinite))].sort((a, b) => a - b);
}

// Where the rover was at that moment, by the last report of a place before it: [x, y] in metres; null if there is none.
export function placeAt({ events, samples, at }, at_s) {
  const known = [...events.map((event) => ({ at_s: at(event.at), ...event })), ...samples.map((sample) => ({ at_s: at(sample.measured_at), ...sample }))];
  const last = known.reduce((best, each) => (each.at_s <= at_s && each.at_s >= (best?.at_s ?? -Infinity) ? each : best), null);
  return last && [last.x_m, last.y_m];
}
