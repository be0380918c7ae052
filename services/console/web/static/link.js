// Messages in flight between Earth and Moon, each where it is now.

import { rewrite } from "./state.js";
import { line, node, text } from "./svg.js";
import { duration, words } from "./words.js";

const EARTH = 46, MOON = 374, LANES = { up: 36, down: 58 };
const SHOWN_AT_LEAST_MS = 700; // at a high simulation speed a flight lasts less than a frame

export class LinkPicture {
  constructor(svg) {
    this.svg = svg;
    this.flights = new Map();
    svg.replaceChildren();
    const circle = (x, r, cls, fill) => svg.append(node("circle", { cx: x, cy: 47, r, fill, stroke: "var(--line)" }));
    for (const y of Object.values(LANES)) svg.append(line(EARTH + 22, y, MOON - 18, y, "var(--line)", 2));
    circle(EARTH, 20, "earth", "#3b82c4");
    svg.append(node("path", { d: "M33 40q6-9 14-6q4 6-2 9q-6 2-5 8q-6-2-7-11zM52 50q7-3 9 2q-3 8-9 9q-3-5 0-11z", fill: "#7fc79a" }));
    circle(MOON, 15, "moon", "#b9c0ca");
    for (const [x, y, r] of [[369, 43, 3], [379, 51, 4], [378, 40, 1.8]]) svg.append(node("circle", { cx: x, cy: y, r, fill: "#98a1ae" }));
    svg.append(text(EARTH, 86, "Earth", "middle"), text(MOON, 86, "Moon", "middle"));
    this.labels = { up: text(210, 26, "", "middle"), down: text(210, 77, "", "middle") };
    svg.append(this.labels.up, this.labels.down);
    this.dots = node("g");
    this.dotOf = new Map(); // key of a flight -> its dot
    svg.append(this.dots);
  }

  // A new status: what is in flight, and what waits.
  take(link) {
    const wall = performance.now();
    for (const flight of link.in_flight) {
      if (flight.departs_at === null || flight.arrives_at === null) continue;
      const key = `${flight.direction} ${flight.topic} ${flight.source} ${flight.sequence} ${flight.offered_at}`;
      if (!this.flights.has(key)) this.flights.set(key, { ...flight, seen: wall });
    }
    this.link = link;
    this.flies = true; // drawn once at least
  }

  draw(now) {
    if (!this.link) return;
    this.flies = this.flights.size > 0;
    const wall = performance.now();
    const flying = { up: new Set(), down: new Set() };
    for (const [key, flight] of this.flights) {
      const length = Math.max(flight.arrives_at - flight.departs_at, 1);
      const real = (now - flight.departs_at) / length;
      const share = real >= 1 || real < 0 ? Math.max(Math.min(real, 1), 0) : real;
      const slow = (wall - flight.seen) / SHOWN_AT_LEAST_MS;
      // As it is, unless that is too quick to see.
      const at = length / 1e6 / Math.max(this.rate || 1, 1e-9) < SHOWN_AT_LEAST_MS ? slow : share;
      if (at >= 1 && slow >= 1) {
        this.flights.delete(key);
        this.dotOf.get(key)?.remove();
        this.dotOf.delete(key);
        continue;
      }
      const isUp = flight.direction === "up", [from, to] = isUp ? [EARTH + 22, MOON - 18] : [MOON - 18, EARTH + 22];
      this.dot(key, flight).setAttribute("cx", (from + (to - from) * Math.min(at, 1)).toFixed(1));
      flying[flight.direction].add(words(flight.topic.split("/").at(-1)));
    }
    const { up, down } = this.link;
    const label = (counts_, arrow, topics) => `${arrow} ${topics}${counts_.waiting ? `, ${counts_.waiting} waiting` : ""}`;
    const named = (names) => (names.size ? [...names].slice(0, 4).join(", ") : "no messages in flight");
    rewrite(this.labels.up, label(up, "→", named(flying.up)));
    rewrite(this.labels.down, label(down, "←", named(flying.down)));
  }

  dot(key, { direction, topic, sequence, size_bytes }) {
    if (!this.dotOf.has(key)) {
      const fill = direction === "up" ? "var(--planned)" : "var(--accent)";
      const dot = node("circle", { cy: LANES[direction], r: size_bytes > 1500 ? 6 : 4.5, fill, stroke: "rgb(0 0 0 / 50%)" });
      dot.append(node("title", {}, `${topic} ${sequence}, ${size_bytes} bytes`));
      this.dotOf.set(key, dot);
      this.dots.append(dot);
    }
    return this.dotOf.get(key);
  }
}

export function describe(link) {
  const { up, down } = link.conditions;
  const light = up.one_way_light_time_s === down.one_way_light_time_s ? duration(up.one_way_light_time_s) : `${duration(up.one_way_light_time_s)} up, ${duration(down.one_way_light_time_s)} down`;
  const rate = (each) => (each.rate_bit_s === null ? null : `${each.rate_bit_s.toLocaleString("en")} bit/s`);
  const parts = [`one-way light time ${light}`];
  if (rate(up) || rate(down)) parts.push(`${rate(up) ?? "unlimited"} up, ${rate(down) ?? "unlimited"} down`);
  if (up.loss || down.loss) parts.push(`${Math.round(100 * Math.max(up.loss, down.loss))} % loss`);
  return parts.join(" · ");
}
