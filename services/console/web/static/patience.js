// When something is asked for again that was not answered: after twice as long each time. Pure; times are milliseconds.

const MOST_MS = 60_000;

export class Patience {
  // first: until the first further try [ms].
  constructor(first) { Object.assign(this, { first, times: 0, until: -Infinity }); }

  mayAsk(now) { return now >= this.until; }

  failed(now) {
    this.until = now + Math.min(MOST_MS, this.first * 2 ** this.times);
    this.times += 1;
  }

  // Answered, or there is reason to think that it would be.
  forget() { this.times = 0; this.until = -Infinity; }
}
