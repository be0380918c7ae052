// The map: a layer in colour, and on it what was measured, driven, planned and drawn.

import { follow } from "./gestures.js";
import * as marks from "./marks.js";
import { clamp, Projection, tenth } from "./projection.js";
import { drawRaster } from "./raster.js";

const ZOOM_STEP = 1.5, PAN_SHARE = .25;
const TILES_A_FRAME = 2;
const BESIDE_PX = 58; // room for the zoom's buttons
const NEAR_PX = { mouse: 9, pen: 11, touch: 16 }; // how near to a sample a click selects it

export class SiteMap {
  constructor(canvas, onHover) {
    this.canvas = canvas;
    this.onHover = onHover;
    this.onPlace = [];          // each called with a place that was taken, and what for: "place", "corner" or "leg"
    this.onView = [];           // each called when another part of the site is seen
    this.onSay = () => {};      // called with what a screen reader is to say
    this.projection = new Projection();
    this.panes = [];            // { source, stops, range, title }: one, or two to swipe between
    this.relief = null;         // the source of the shading of the relief
    this.split = .5;            // share of the frame to the left of the swipe
    this.track = null;
    this.rover = null;          // { x_m, y_m, heading_deg, stale }
    this.areas = [];            // { corners, kind, name, note, selected }
    this.chosen = null;         // [x, y]
    this.sample = null;         // id of the selected sample
    this.cross = null;          // [x, y] while the keyboard leads
    this.draft = [];            // corners of the area that is drawn
    this.legs = [];             // corners of the line that is measured
    this.preview = null;        // the way of a command that is not sent yet
    this.pointed = null;        // where the rover was at the moment that is pointed at on the timeline
    this.rehearsed = null;      // [{ tracks, colour }] of the flights of a rehearsal
    this.proposal = null;       // { path, checked, samples, selected, editable } of the plan that waits for approval
    this.onStop = () => {};     // called with the number of a stop of that plan, and where it was dragged to; null: it was chosen
    this.adding = false;        // whether a place that is taken is a further stop of that plan
    this.drawing = false;
    this.measuring = false;
    this.show = { paths: true, samples: true };
    this.due = false;
    follow(canvas, this);
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("blur", () => { this.cross = null; this.draw(); });
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  setSite(site) {
    const known = this.projection.site;
    this.projection.site = site;
    if (known.rows !== site.rows || known.columns !== site.columns || known.resolution_m !== site.resolution_m) this.seen();
  }

  get width() { return this.projection.width; }
  get height() { return this.projection.height; }
  at(x, y) { return this.projection.at(x, y); }

  resize() {
    const box = this.canvas.getBoundingClientRect();
    this.ratio = window.devicePixelRatio || 1;
    this.projection.size = [box.width, box.height];
    const [width, height] = [box.width, box.height].map((side) => Math.round(side * this.ratio));
    if (this.canvas.width === width && this.canvas.height === height) { this.seen(); return; }
    this.canvas.width = width; // which empties the canvas
    this.canvas.height = height;
    this.seen();
    this.drawNow(); // before the browser shows it empty
  }

  // The place under a pixel; null off the site or outside the frame.
  place(px, py) {
    const { left, right, top, bottom } = this.projection.box;
    if (px < left || px > right || py < top || py > bottom) return null;
    const [x, y] = this.projection.from(px, py);
    return [tenth(clamp(x, 0, this.width)), tenth(clamp(y, 0, this.height))];
  }

  // The pane that is seen at a pixel.
  paneAt(px) { return this.panes.length > 1 && px > this.splitAt ? this.panes[1] : this.panes[0]; }
  get splitAt() { const { left, right } = this.projection.box; return left + this.split * (right - left); }

  setPanes(panes, relief) {
    this.panes = panes;
    this.relief = relief;
    this.draw();
  }

  // Resolves when all that is seen of these sources is loaded.
  async loaded(sources) {
    if (!this.projection.size) return;
    const { window: part, scale } = this.projection;
    await Promise.all(sources.map((source) => source.loadAll(source.needed(part, scale * this.ratio))));
  }

  // --- the part that is seen ----------------------------------------------------------------------------------------

  isWhole() { return this.projection.zoom <= 1; }

  zoomBy(factor, px, py) {
    const { left, top, width, height } = this.projection.frame;
    this.projection.zoomTo(this.projection.zoom * factor, px ?? left + width / 2, py ?? top + height / 2);
    this.seen();
  }

  panBy(dx, dy) { this.projection.panBy(dx, dy); this.seen(); }
  fit() { this.look(1, null); }
  look(zoom, centre) { this.projection.look(zoom, centre); this.seen(); }

  // The smallest part of the site that shows these places with some room around them.
  frame(places) {
    const [west, east, south, north] = [[0, Math.min], [0, Math.max], [1, Math.min], [1, Math.max]].map(([axis, most]) => most(...places.map((place) => place[axis])));
    const { width, height } = this.projection.frame, { fitting } = this.projection;
    this.look(Math.min(width / ((east - west) * 1.6 + 1e-9), height / ((north - south) * 1.6 + 1e-9)) / fitting, [(west + east) / 2, (south + north) / 2]);
  }

  seen() {
    this.projection.settle();
    this.canvas.classList.toggle("zoomed", !this.isWhole());
    for (const callback of this.onView) callback();
    this.draw();
  }

  // --- places -------------------------------------------------------------------------------------------------------

  hover(px, py, event) {
    if (px === null) { this.onHover(null); return; }
    const sample = this.sampleNear(px, py, NEAR_PX.mouse);
    this.canvas.classList.toggle("on-sample", sample !== null && !this.picks);
    this.canvas.classList.toggle("on-stop", this.grab(px, py) !== null);
    this.onHover(this.place(px, py), [px, py], event, sample);
  }

  // The number of the plan's stop under a pointer, which a drag then moves; null if there is none.
  grab(px, py, kind) {
    if (!this.proposal?.editable || this.drawing || this.measuring || this.adding) return null;
    let nearest = null, best = NEAR_PX[kind] ?? NEAR_PX.mouse;
    this.proposal.samples.forEach(({ x_m, y_m }, index) => {
      const [x, y] = this.at(x_m, y_m), away = Math.hypot(x - px, y - py);
      if (away <= best) { best = away; nearest = index; }
    });
    return nearest;
  }

  dragStop(index, px, py) {
    const { left, right, top, bottom } = this.projection.box, place = this.place(clamp(px, left, right), clamp(py, top, bottom));
    if (place && this.proposal) this.onStop(index, place);
  }

  take(px, py, event) {
    const place = this.place(px, py);
    if (!place) return;
    this.cross = null;
    const stop = this.grab(px, py, event.pointerType);
    if (stop !== null) this.onStop(stop, null);
    const near = this.picks ? null : this.sampleNear(px, py, NEAR_PX[event.pointerType] ?? NEAR_PX.mouse);
    this.choose(near ? [near.x_m, near.y_m] : place, near?.sample_id ?? null);
  }

  // Whether places are picked for something, so that no sample is selected.
  get picks() { return this.drawing || this.measuring || this.adding; }

  sampleNear(px, py, within) {
    let nearest = null, best = within;
    for (const sample of this.show.samples ? this.track?.samples ?? [] : []) {
      const [x, y] = this.at(sample.x_m, sample.y_m), away = Math.hypot(x - px, y - py);
      if (away <= best) { best = away; nearest = sample; }
    }
    return nearest;
  }

  // The areas that hold a place.
  areasAt([x, y]) {
    return this.areas.filter(({ corners }) => {
      let inside = false;
      corners.forEach(([x1, y1], index) => {
        const [x2, y2] = corners.at(index - 1);
        if (y1 > y !== y2 > y && x < x1 + ((y - y1) / (y2 - y1)) * (x2 - x1)) inside = !inside;
      });
      return inside;
    });
  }

  choose(place, sample = null) {
    const what = this.drawing ? "corner" : this.measuring ? "leg" : this.adding ? "stop" : "place";
    if (what === "corner") this.draft.push(place);
    else if (what === "leg") this.legs.push(place);
    else if (what === "place") { this.chosen = place; this.sample = sample; }
    for (const callback of this.onPlace) callback(place, what);
    this.draw();
  }

  // Where the keyboard is: at the cross-hair, else where something was set last.
  get cursor() { return this.cross ?? (this.drawing ? this.draft : this.measuring ? this.legs : []).at(-1) ?? this.chosen ?? this.projection.middle.map(tenth); }

  key(event) {
    const { frame } = this.projection, step = event.shiftKey ? 25 : event.altKey ? 1 : 5;
    const directions = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const zooms = { "+": ZOOM_STEP, "=": ZOOM_STEP, "-": 1 / ZOOM_STEP, _: 1 / ZOOM_STEP };
    if (event.key in directions && (event.ctrlKey || event.metaKey)) {
      const [dx, dy] = directions[event.key];
      this.panBy(-dx * frame.width * PAN_SHARE, dy * frame.height * PAN_SHARE);
    } else if (event.key in directions) {
      const [dx, dy] = directions[event.key], [x, y] = this.cursor;
      this.cross = [tenth(clamp(x + dx * step, 0, this.width)), tenth(clamp(y + dy * step, 0, this.height))];
      if (!this.isWhole()) { this.projection.reveal(...this.cross); this.seen(); }
      this.onHover(this.cross, this.at(...this.cross), event);
      this.draw();
    } else if (event.key in zooms && !event.ctrlKey && !event.metaKey) {
      this.zoomBy(zooms[event.key], ...(this.cross ? this.at(...this.cross) : []));
      this.onSay(`zoom ${tenth(this.projection.zoom)}`);
    } else if (event.key === "0" && !event.ctrlKey && !event.metaKey) {
      this.fit();
      this.onSay("whole site");
    } else if (event.key === "Enter" || event.key === " ") {
      const place = this.cursor, [px, py] = this.at(...place);
      const near = this.picks ? null : this.sampleNear(px, py, NEAR_PX.mouse);
      this.choose(near ? [near.x_m, near.y_m] : place, near?.sample_id ?? null);
    } else return;
    event.preventDefault();
  }

  // --- drawing ------------------------------------------------------------------------------------------------------

  // Everything is drawn anew before the next frame, once.
  draw() {
    if (this.due || !this.projection.size) return;
    this.due = true;
    requestAnimationFrame(() => { this.due = false; this.drawNow(); });
  }

  drawNow() {
    const context = this.canvas.getContext("2d"), effort = { tiles: TILES_A_FRAME, short: false };
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, ...this.projection.size);
    this.paint(context, this.ratio, effort);
    if (effort.short) this.draw();
  }

  // Draws the map into a context whose unit is a pixel of the page; ratio: pixels of the picture in it. effort: of drawRaster.
  paint(context, ratio, effort = { tiles: Infinity }) {
    const { projection } = this, style = getComputedStyle(document.documentElement), known = {};
    const colour = (name) => (known[name] ??= style.getPropertyValue(name).trim());
    const { left, right, top, bottom } = projection.box;
    context.fillStyle = colour("--field");
    context.fillRect(left, top, right - left, bottom - top);
    marks.axes(context, projection, colour);
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    this.rasters(context, ratio, effort);
    for (const each of this.areas) marks.area(context, projection, colour, each);
    if (this.track && this.show.paths) marks.paths(context, projection, colour, this.track);
    if (this.track && this.show.samples) marks.samples(context, projection, colour, this.track.samples, this.sample);
    for (const each of this.areas) marks.areaName(context, projection, colour, each);
    if (this.draft.length) marks.corners(context, projection, this.draft.length > 2 ? [...this.draft, this.draft[0]] : this.draft, colour("--accent"));
    if (this.legs.length) marks.measured(context, projection, this.legs, colour("--planned"));
    if (this.rehearsed && this.show.rehearsed) marks.rehearsed(context, projection, colour, this.rehearsed);
    if (this.proposal) marks.proposed(context, projection, colour, this.proposal);
    if (this.preview?.length) {
      marks.undecided(context, projection, colour, this.preview);
      marks.target(context, projection, this.preview.at(-1), colour("--preview"));
    }
    if (this.chosen && !this.sample) marks.target(context, projection, this.chosen, "#fff");
    if (this.cross) marks.target(context, projection, this.cross, colour("--planned"), true);
    if (this.pointed) marks.target(context, projection, this.pointed, colour("--accent")); // by the timeline's cursor
    if (this.rover) marks.vehicle(context, projection, colour, this.rover);
    if (this.panes.length > 1) this.titles(context);
    if (this.panes.length) marks.scaleBar(context, projection);
    context.restore();
  }

  rasters(context, ratio, effort) {
    const { left, right, top, bottom } = this.projection.box;
    this.panes.forEach((pane, index) => {
      context.save();
      if (index) {
        context.beginPath();
        context.rect(this.splitAt, top, right - this.splitAt, bottom - top);
        context.clip();
      }
      this.raster(context, pane.source, pane, ratio, effort);
      context.restore();
    });
    if (!this.relief) return;
    context.save();
    context.globalCompositeOperation = "soft-light"; // grey in the middle changes nothing
    const flat = Math.SQRT1_2, most = .3;
    this.raster(context, this.relief, { stops: ["#000000", "#ffffff"], range: [flat - most, flat + most], blended: true }, ratio, effort);
    context.restore();
  }

  raster(context, source, look, ratio, effort) {
    const places = drawRaster(context, source, look, this.projection, ratio, effort);
    source.fetch(places, () => this.draw());
  }

  titles(context) {
    const { left, right, top, bottom } = this.projection.box, x = this.splitAt;
    context.fillStyle = "#fff";
    context.fillRect(x - 1.5, top, 3, bottom - top);
    context.font = "600 11px system-ui, sans-serif";
    const [first, second] = this.panes.map(({ title }) => title), width = context.measureText(second).width;
    marks.label(context, first, [left + 6, top + 22], "#fff");
    marks.label(context, second, [Math.max(right - width - BESIDE_PX, left), top + (right - left < 2 * width + 2 * BESIDE_PX ? 40 : 22)], "#fff");
  }
}
