// SPDX-License-Identifier: Apache-2.0
// The rows of one trial, as the monitor sends them: for each signal the range of the real trials and the simulation in it.

export const MEAN = 1, LOWER = 2, UPPER = 3, SIMULATED = 4, BEFORE = 5, INSIDE = 6; // columns of a signal; 0 is time
export const UNSEEN = -1, OUTSIDE = 0, COLLECTING = 2;
const DEG = 180 / Math.PI, SHOWN = { rad: ["deg", DEG], "rad/s": ["deg/s", DEG], m: ["mm", 1000], "m/s": ["mm/s", 1000] };
let units = {}; // signal -> SI unit, as the rig's model states them

export const learnUnits = (message) => { units = message || {}; };
export const siOf = (name) => units[name] || (name.startsWith("ball_") ? "m" : name.endsWith("_effort") ? "N m"
  : name.endsWith("_velocity") ? "rad/s" : "rad");
// The unit that people read instead of an SI unit, and the factor to it.
export const shownUnit = (si) => SHOWN[si] || [si, 1];
export const unitOf = (name) => shownUnit(siOf(name));
const NAMES = ["mean", "lower", "upper", "simulated", "model_before"];

export class Table {
  constructor({ key, signals, step, duration }) {
    Object.assign(this, { key, signals, step, duration, fresh: [], last: -1, columns: signals.map(() => [[], [], [], [], [], [], []]) });
  }

  holds(message) { return !message.whole && message.key === this.key && String(message.signals) === String(this.signals); }

  fill(message, clock = 0) {
    const factors = this.signals.map((name) => unitOf(name)[1]);
    for (const [row, ...cells] of message.rows) {
      cells.forEach((cell, s) => {
        const column = this.columns[s];
        for (let i = column[0].length; i <= row; i++) {
          column[0].push(i * this.step);
          for (let c = MEAN; c <= BEFORE; c++) column[c].push(null);
          column[INSIDE].push(UNSEEN);
        }
        for (let c = MEAN; c <= BEFORE; c++) column[c][row] = cell[c - 1] === null ? null : cell[c - 1] * factors[s];
        column[INSIDE][row] = cell[INSIDE - 1];
      });
      this.fresh[row] = clock;
    }
    if (message.rows.length && message.rows.length < 200) this.last = message.rows[message.rows.length - 1][0];
    return this;
  }

  get end() { return Math.max(this.duration, (this.columns[0] ? this.columns[0][0].length : 0) * this.step); }

  // Whether a single real trial is all there is so far, so that the tunnel has no width.
  get collecting() { return this.columns.some((column) => column[INSIDE].includes(COLLECTING)); }

  // Runs of samples outside as [first, last row, newest time].
  outside(s) {
    const inside = this.columns[s][INSIDE], runs = [];
    for (let i = 0; i < inside.length; i++) {
      if (inside[i] !== OUTSIDE) continue;
      const run = runs[runs.length - 1];
      if (run && run[1] === i - 1) { run[1] = i; run[2] = Math.max(run[2], this.fresh[i] || 0); }
      else runs.push([i, i, this.fresh[i] || 0]);
    }
    return runs;
  }

  // SI units, one row a sample; empty where a value is not known.
  csv() {
    const header = ["time_s", ...this.signals.flatMap((name) => [...NAMES.map((what) => `${name}_${what}_${siOf(name).replace(" ", "_")}`), `${name}_inside`])];
    const lines = [header.join(",")];
    for (let i = 0; i < (this.columns[0] ? this.columns[0][0].length : 0); i++) {
      const cells = this.columns.flatMap((column, s) => [
        ...[MEAN, LOWER, UPPER, SIMULATED, BEFORE].map((c) => (column[c][i] === null ? "" : Number((column[c][i] / unitOf(this.signals[s])[1]).toPrecision(9)))),
        column[INSIDE][i] === UNSEEN || column[INSIDE][i] === COLLECTING ? "" : column[INSIDE][i]]);
      lines.push([Number((i * this.step).toFixed(6)), ...cells].join(","));
    }
    return `${lines.join("\n")}\n`;
  }
}
