// Made-up facts through the model of the page's timeline; run in the page by test_timeline.py.
const done = arguments[0];
import("/static/timelinemodel.js").then((model) => {
  const at = (minutes) => minutes * 6e10, plan = (round, from, to) => ({ kind: "plan", round, begins_at: at(from), ends_at: at(to), at: 0 });
  const event = (kind, round, minutes) => ({ kind, round, at: at(minutes), received_at: at(minutes), detail: "", x_m: minutes, y_m: 1 });
  const facts = (now, heard, events) => model.moments({
    start_ns: 0, now_ns: at(now), heard_ns: at(heard), entries: [plan(1, 0, 60), plan(2, 60, 120), plan(2, 65, 125)], events, samples: [],
    modes: [{ mode: "driving", made_at: at(1) }, { mode: "drilling", made_at: at(90), before_at: at(50) }],
    commands: ["a", "b"].map((id) => ({ command: { kind: "pause", command_id: id }, stages: [{ stage: "queued", at: at(10) }], end: null, by: "" })),
    contacts: { events: [{ at: 0, contact: true, what: "", by: "" }, { at: at(20), contact: false, what: "contact off", by: "anna" }], ahead: [[at(200), at(260)]] },
    alarms: { current: [], history: [] },
  });
  const flown = [event("round_started", 1, 5), event("round_completed", 1, 70), event("round_started", 2, 70)];
  const during = facts(100, 95, flown), over = facts(150, 140, flown), lanes = model.lanes(during);
  const spans = (lane) => lanes[lane].items.map(({ from, to, look, row }) => [look, from / 60, to / 60, row ?? 0]);
  const waits = { ...during, proposal: { plan: { round: 3 }, lasts_s: 1800 }, preview: { command: { kind: "go_to" }, received_at: at(102), word_back_at: at(104) } };
  const proposed = model.lanes(waits).flatMap(({ items }) => items.filter(({ look }) => look === "proposed"));
  done({
    labels: [
      [[100, 200], 40, []], [[100, 200], 40, [[110, 110], [120, 120], [165, 165]]], [[100, 120], 40, [[100, 100], [120, 120]]],
      [[100, 120], 40, [[130, 130]]], [[100, 120], 40, [[150, 170]]], [[100, 200], 40, [[90, 150]]], [[-50, 60], 40, []], [[270, 290], 40, []],
    ].map(([item, needs, taken]) => model.labelPlace(item, needs, taken, [0, 300])).map((place) => place && [place.left, place.within]),
    places: [4, 69, 70, 99].map((minutes) => model.placeAt(during, minutes * 60)?.[0] ?? null),
    proposed: proposed.map(({ from, to, label }) => [label, from / 60, to / 60]),
    rounds: spans(0), rover: spans(1), rows: spans(2).map(([, , , row]) => row), contact: spans(3),
    deviations: [facts(8, 7, flown.slice(0, 1)), facts(75, 72, flown.slice(0, 2)), during, over].map((each) => model.deviation(each)?.behind_s / 60),
    text: model.deviationText(over), next: model.contactText(during), said: model.described(lanes, 55 * 60), edges: model.edges(lanes).slice(0, 4).map((each) => each / 60),
  });
});
