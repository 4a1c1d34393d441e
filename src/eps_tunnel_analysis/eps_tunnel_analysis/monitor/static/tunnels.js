// SPDX-License-Identifier: Apache-2.0
// The tunnel of each signal with the simulation in it, and where the simulation is outside.
import { AXIS, cleared, colour } from "/static/colours.js";
import { percent } from "/static/gap.js";

const MEAN = 1, LOWER = 2, UPPER = 3, SIMULATED = 4, BEFORE = 5, INSIDE = 6; // columns of a signal; 0 is time
const GLOW = 1500; // ms for which a sample that fell outside lights up
const HEIGHT = 150;
const unitOf = (name) => (name.startsWith("ball_") ? ["mm", 1000] : name.endsWith("_effort") ? ["N m", 1]
  : name.endsWith("_velocity") ? ["deg/s", 180 / Math.PI] : ["deg", 180 / Math.PI]);

export class Tunnels {
  constructor() { this.forget(); }

  // Everything will be told anew.
  forget() { this.key = null; this.signals = []; this.columns = []; this.fresh = []; this.last = -1; this.changed = true; this.forgetCharts(); }

  forgetCharts() {
    (this.charts || []).forEach((chart) => chart.destroy());
    this.charts = [];
    document.getElementById("tunnels").replaceChildren();
    this.changed = true;
  }

  take(table) {
    if (table.whole || table.key !== this.key || String(table.signals) !== String(this.signals)) {
      this.forget();
      this.key = table.key; this.signals = table.signals; this.step = table.step; this.duration = table.duration;
      this.columns = table.signals.map(() => [[], [], [], [], [], [], []]);
      this.fresh = [];
    }
    const clock = performance.now(), factors = this.signals.map((name) => unitOf(name)[1]);
    for (const [row, ...cells] of table.rows) {
      cells.forEach((cell, s) => {
        const column = this.columns[s];
        for (let i = column[0].length; i <= row; i++) {
          column[0].push(i * this.step);
          for (let c = MEAN; c <= BEFORE; c++) column[c].push(null);
          column[INSIDE].push(-1);
        }
        for (let c = MEAN; c <= BEFORE; c++) column[c][row] = cell[c - 1] === null ? null : cell[c - 1] * factors[s];
        column[INSIDE][row] = cell[INSIDE - 1];
      });
      this.fresh[row] = clock;
    }
    if (table.rows.length && table.rows.length < 200) this.last = table.rows[table.rows.length - 1][0];
    this.changed = true;
  }

  // What the newest sample says: signal -> whether it is inside; null where nothing is known.
  now() {
    if (this.last < 0 || performance.now() - (this.fresh[this.last] || 0) > GLOW) return null;
    return Object.fromEntries(this.signals.map((name, s) => [name, this.columns[s][INSIDE][this.last] !== 0]));
  }

  draw(run, gap) {
    const glowing = this.last >= 0 && performance.now() - (this.fresh[this.last] || 0) < GLOW + 500;
    if (!this.changed && !glowing) return;
    this.changed = false;
    if (!this.signals.length) { cleared(document.getElementById("where"), 0); return; }
    if (!this.charts.length) this.make();
    this.charts.forEach((chart, s) => {
      const c = this.columns[s];
      chart.setData([c[0], c[UPPER], c[LOWER], c[MEAN], c[BEFORE], c[SIMULATED]]);
    });
    const known = gap && String(gap.signals) === String(this.signals);
    this.shares.forEach((share, s) => { share.textContent = known ? `${percent(gap.shares[s][0])} alike` : ""; });
    document.getElementById("tunnel-what").textContent = run
      ? `${run.sequence}, trial ${run.trial + 1} of ${run.trials}. The band is what the real trials spanned; red is where the simulation leaves it.`
      : "The band is what the real trials spanned; red is where the simulation leaves it.";
    this.drawWhere();
  }

  make() {
    // All boxes first: how wide one is depends on how many there are.
    const boxes = this.signals.map((name) => {
      const [box, head, title, share] = ["div", "div", "b", "span"].map((tag) => document.createElement(tag));
      head.className = "name"; title.textContent = `${name}, ${unitOf(name)[0]}`;
      head.append(title, share); box.append(head);
      return box;
    });
    document.getElementById("tunnels").replaceChildren(...boxes);
    this.shares = boxes.map((box) => box.firstElementChild.lastElementChild);
    this.charts = boxes.map((box, s) => new uPlot({
      width: box.clientWidth, height: HEIGHT, cursor: { show: false }, legend: { show: false }, padding: [6, 14, 0, 0],
      scales: {
        x: { time: false, range: () => [0, Math.max(this.duration, this.columns[s][0].length * this.step)] },
        y: { range: (u, low, high) => { const pad = 0.08 * Math.max(high - low, 0.2); return [low - pad, high + pad]; } },
      },
      axes: [{ ...AXIS(), values: (u, all) => all.map((t) => `${t} s`), size: 24 }, { ...AXIS(), size: 40 }],
      bands: [{ series: [1, 2], fill: colour("tunnel") }],
      series: [{}, { stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } },
        { stroke: colour("real"), width: 1.2, points: { show: false } },
        { stroke: colour("before"), width: 1.2, dash: [5, 4], points: { show: false } },
        { stroke: colour("sim"), width: 1.8, points: { show: false } }],
      hooks: { drawClear: [(u) => this.drawOutside(u, s)] },
    }, [[], [], [], [], [], []], box));
  }

  // Runs of samples outside as [first, last row, newest time].
  outside(s) {
    const inside = this.columns[s][INSIDE], runs = [];
    for (let i = 0; i < inside.length; i++) {
      if (inside[i] !== 0) continue;
      const run = runs[runs.length - 1];
      if (run && run[1] === i - 1) { run[1] = i; run[2] = Math.max(run[2], this.fresh[i] || 0); }
      else runs.push([i, i, this.fresh[i] || 0]);
    }
    return runs;
  }

  drawOutside(u, s) {
    const context = u.ctx;
    context.save();
    for (const [first, last] of this.outside(s)) {
      const left = u.valToPos((first - 0.5) * this.step, "x", true), right = u.valToPos((last + 0.5) * this.step, "x", true);
      context.fillStyle = colour("outside");
      context.fillRect(left, u.bbox.top, Math.max(right - left, 1), u.bbox.height);
    }
    const age = this.last >= 0 ? performance.now() - (this.fresh[this.last] || 0) : GLOW;
    if (age < GLOW) {
      const x = u.valToPos(this.last * this.step, "x", true), failed = this.columns[s][INSIDE][this.last] === 0;
      context.globalAlpha = 1 - age / GLOW;
      context.fillStyle = failed ? colour("glow") : colour("muted");
      context.fillRect(x - 1, u.bbox.top, failed ? 4 : 2, u.bbox.height);
    }
    context.restore();
  }

  drawWhere() {
    const row = 15, canvas = document.getElementById("where"), label = 84;
    const [context, width] = cleared(canvas, this.signals.length * row + 2);
    const rows = Math.max(this.columns[0][0].length, Math.round(this.duration / this.step)), scale = (width - label) / rows, clock = performance.now();
    context.font = "11px system-ui, sans-serif"; context.textBaseline = "middle";
    this.signals.forEach((name, s) => {
      const y = s * row;
      context.fillStyle = colour("muted"); context.fillText(name, 0, y + row / 2);
      context.fillStyle = colour("grid"); context.fillRect(label, y + 2, width - label, row - 4);
      const inside = this.columns[s][INSIDE];
      context.fillStyle = colour("real"); context.globalAlpha = 0.35;
      for (let i = 0; i < inside.length; i++) if (inside[i] === 1) context.fillRect(label + i * scale, y + 2, scale + 0.5, row - 4);
      for (const [first, last, newest] of this.outside(s)) {
        const glow = Math.max(0, 1 - (clock - newest) / GLOW);
        context.globalAlpha = 0.6 + 0.4 * glow;
        context.fillStyle = colour("glow");
        context.fillRect(label + first * scale, y + 2 - glow, Math.max((last + 1 - first) * scale, 1.5), row - 4 + 2 * glow);
      }
      context.globalAlpha = 1;
    });
  }
}
