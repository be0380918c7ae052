// The layers of the map as tiles: squares of at most 512 x 512 cells, fetched for the part that is seen. At level k a
// cell is 2^k cells of the map wide, and has the value of the map at its centre. Row 0 of a tile is in the south.

import { ask } from "./net.js";
import { Patience } from "./patience.js";
import { clamp } from "./projection.js";

const TILE = 512, KEPT = 24, AT_ONCE = 4, AGAIN_MS = 2000;
const STEPS = 65535;

// One layer at one revision of the map.
export class TileSource {
  constructor(site, { layer, threshold, revision }) {
    Object.assign(this, { site, layer, threshold, revision, about: null, kept: KEPT });
    this.tiles = new Map();     // key -> tile; the last used is the last
    this.waiting = new Map();   // key -> promise
    this.failed = new Map();    // key -> Patience
    this.top = Math.max(0, Math.ceil(Math.log2(Math.max(site.rows, site.columns) / TILE)));
  }

  // Loads the whole site, coarse where it is large: from then on there is something to show everywhere.
  async begin() {
    const whole = await this.load([this.top, 0, 0]);
    this.about = whole.about;
    this.low = whole.about.low;
    this.high = whole.about.high;
    this.revision = this.revision === null ? null : whole.about.revision; // all further tiles are of the same map
    return this;
  }

  // The coarsest level whose cells are no larger than a pixel of the screen, or the map's own cells.
  levelFor(scale) { return clamp(Math.floor(-Math.log2(this.site.resolution_m * scale)), 0, this.top); }

  // What has to be drawn for that part of the site [m], at that number of pixels a metre.
  needed({ west, south, east, north }, scale) {
    const level = this.levelFor(scale), side = this.side(level), places = [];
    const last = (metres) => Math.max(0, Math.ceil(metres / side - 1e-9) - 1);
    for (let row = Math.max(0, Math.floor(south / side)); row <= last(north); row++) {
      for (let column = Math.max(0, Math.floor(west / side)); column <= last(east); column++) places.push([level, row, column]);
    }
    this.kept = Math.max(KEPT, 2 * places.length); // never fewer than what is seen
    return places;
  }

  side(level) { return TILE * this.site.resolution_m * 2 ** level; }

  tile(place) {
    const key = place.join(" "), found = this.tiles.get(key);
    if (found && this.tiles.size > 1) { this.tiles.delete(key); this.tiles.set(key, found); }
    return found;
  }

  // Loads the tiles that are missing, a few at a time; resolves when all of them are there.
  async loadAll(places) { await Promise.all(places.map((place) => this.load(place))); }

  // Begins to load what is missing, unless enough is on its way; `onTile` is called for each that has come.
  fetch(places, onTile) {
    for (const place of places) {
      const key = place.join(" ");
      if (this.tiles.has(key) || this.waiting.has(key) || this.waiting.size >= AT_ONCE) continue;
      if (!(this.failed.get(key)?.mayAsk(performance.now()) ?? true)) continue;
      this.load(place).then((tile) => { this.failed.delete(key); onTile(tile); }, () => this.fail(key, onTile));
    }
  }

  fail(key, onTile) {
    const patience = this.failed.get(key) ?? new Patience(AGAIN_MS), now = performance.now();
    this.failed.set(key, patience);
    patience.failed(now);
    setTimeout(onTile, patience.until - now);
  }

  load(place) {
    const key = place.join(" "), found = this.tiles.get(key);
    if (found) return Promise.resolve(found);
    if (!this.waiting.has(key)) this.waiting.set(key, this.ask(place).then((tile) => this.keep(key, tile)).finally(() => this.waiting.delete(key)));
    return this.waiting.get(key);
  }

  keep(key, tile) {
    this.tiles.set(key, tile);
    for (const old of this.tiles.keys()) {
      if (this.tiles.size <= this.kept) break;
      if (old !== `${this.top} 0 0`) this.tiles.delete(old);
    }
    return tile;
  }

  async ask([level, row, column]) {
    const { site } = this, side = this.side(level), x_min = column * side, y_min = row * side;
    const response = await ask("map/box", {
      layer: this.layer, threshold: this.threshold, as_of: this.revision, format: "packed", x_min, y_min,
      x_max: Math.min(x_min + side, site.columns * site.resolution_m), y_max: Math.min(y_min + side, site.rows * site.resolution_m),
      resolution_m: site.resolution_m * 2 ** level,
    });
    const about = JSON.parse(response.headers.get("x-map-about"));
    const planes = await new Response(response.body.pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
    return { about, values: unpacked(new Uint8Array(planes), about) };
  }

  // The value at a place from the finest tile that is there, and whether that is the map's own cell.
  valueAt([x, y]) {
    for (let level = 0; level <= this.top; level++) {
      const side = this.side(level), tile = this.tiles.get([level, Math.floor(y / side), Math.floor(x / side)].join(" "));
      if (!tile) continue;
      const { rows, columns, resolution_m: step, x_min_m, y_min_m } = tile.about;
      const row = clamp(Math.floor((y - y_min_m) / step), 0, rows - 1), column = clamp(Math.floor((x - x_min_m) / step), 0, columns - 1);
      return { value: tile.values[row * columns + column], exact: level === 0 };
    }
    return null;
  }
}

// One layer less the same layer at another revision.
export class Difference {
  constructor(now, then) {
    Object.assign(this, { now, then, layer: now.layer, about: now.about, top: now.top });
    this.tiles = new WeakMap(); // tile of `now` -> the difference
    const whole = this.tile([this.top, 0, 0]);
    let most = 0;
    for (const value of whole.values) most = Math.max(most, Math.abs(value));
    this.low = -most;
    this.high = most;
  }

  needed(window, scale) { return this.now.needed(window, scale); }
  fetch(places, onTile) { this.now.fetch(places, onTile); this.then.fetch(places, onTile); }
  loadAll(places) { return Promise.all([this.now.loadAll(places), this.then.loadAll(places)]); }

  tile(place) {
    const now = this.now.tile(place), then = this.then.tile(place);
    if (!now || !then) return undefined;
    if (!this.tiles.has(now)) this.tiles.set(now, { about: now.about, values: now.values.map((value, index) => value - then.values[index]) });
    return this.tiles.get(now);
  }

  valueAt(place) {
    const now = this.now.valueAt(place), then = this.then.valueAt(place);
    return now && then && { value: now.value - then.value, exact: now.exact && then.exact };
  }
}

// See services/ground/map/packing.py.
function unpacked(planes, { rows, columns, low, high }) {
  const count = rows * columns, values = new Float32Array(count), steps = new Uint16Array(columns), step = (high - low) / STEPS;
  for (let index = 0; index < count;) {
    for (let column = 0, along = 0; column < columns; column++, index++) {
      const folded = (planes[index] << 8) | planes[count + index];
      along += (folded >> 1) ^ -(folded & 1);
      steps[column] += along;
      values[index] = low + step * steps[column];
    }
  }
  return values;
}

// Draws what there is of a source; what is missing is drawn from the whole site, coarse. What is blended is drawn once.
// `effort.tiles`: how many tiles may be coloured now, so that a frame stays short; `effort.short`: whether that was too few.
export function drawRaster(context, source, look, projection, ratio, effort) {
  const places = source.needed(projection.window, projection.scale * ratio);
  const ready = places.filter((place) => source.tile(place) && isColoured(source.tile(place), look, effort)).map((place) => source.tile(place));
  const complete = ready.length === places.length;
  if (!complete) drawTile(context, source.tile([source.top, 0, 0]), look, projection);
  if (complete || !look.blended) for (const tile of ready) drawTile(context, tile, look, projection);
  return places;
}

function isColoured(tile, look, effort) {
  if (tile.pictureKey === keyOf(look)) return true;
  if (effort.tiles <= 0) { effort.short = true; return false; }
  effort.tiles -= 1;
  return true;
}

function drawTile(context, tile, look, projection) {
  if (!tile) return;
  const { rows, columns, resolution_m: step, x_min_m: west, y_min_m: south } = tile.about;
  const [left, bottom] = projection.at(west, south), [right, top] = projection.at(west + columns * step, south + rows * step);
  // Neighbours meet at whole pixels.
  const [x, y, x2, y2] = [left, top, right, bottom].map((value) => Math.round(value));
  context.imageSmoothingEnabled = step * projection.scale < 1;
  context.drawImage(pictureOf(tile, look), x, y, x2 - x, y2 - y);
}

const keyOf = ({ stops, range: [low, high] }) => `${stops.join()} ${low} ${high}`;

// The tile in colour, one pixel a cell, north up.
function pictureOf(tile, look) {
  const { stops, range: [low, high] } = look, key = keyOf(look);
  if (tile.pictureKey === key) return tile.picture;
  const { rows, columns } = tile.about, { values } = tile;
  const picture = new OffscreenCanvas(columns, rows), context = picture.getContext("2d");
  const image = context.createImageData(columns, rows), pixels = new Uint32Array(image.data.buffer), table = tableOf(stops);
  const scale = 255 / Math.max(high - low, 1e-12);
  for (let row = 0; row < rows; row++) {
    const from = row * columns, to = (rows - 1 - row) * columns;
    for (let column = 0; column < columns; column++) {
      const shade = ((values[from + column] - low) * scale) | 0;
      pixels[to + column] = table[shade < 0 ? 0 : shade > 255 ? 255 : shade];
    }
  }
  context.putImageData(image, 0, 0);
  Object.assign(tile, { picture, pictureKey: key });
  return picture;
}

const tables = new Map();
function tableOf(stops) {
  const key = stops.join();
  if (tables.has(key)) return tables.get(key);
  const fixedColours = stops.map((stop) => [1, 3, 5].map((start) => parseInt(stop.slice(start, start + 2), 16)));
  const table = new Uint32Array(256);
  for (let index = 0; index < 256; index++) {
    const place = (index / 255) * (fixedColours.length - 1), whole = Math.min(Math.floor(place), fixedColours.length - 2), part = place - whole;
    const [r, g, b] = fixedColours[whole].map((value, channel) => Math.round(value + (fixedColours[whole + 1][channel] - value) * part));
    table[index] = (255 << 24) | (b << 16) | (g << 8) | r;
  }
  tables.set(key, table);
  return table;
}
