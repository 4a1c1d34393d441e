// SPDX-License-Identifier: Apache-2.0
// The tunnel of each signal with the simulation in it, and where the simulation is outside; now, in a trial gone by, or with a
// value of the model moved.
import { AXIS, cleared, colour } from "/static/colours.js";
import { percent } from "/static/gap.js";
import { BEFORE, COLLECTING, INSIDE, LOWER, MEAN, SIMULATED, Table, UPPER, unitOf } from "/static/table.js";

const GLOW = 1500; // ms for which a sample that fell outside lights up
const HEIGHT = 150;
const element = (id) => document.getElementById(id);
const shown = (value) => (value === null || value === undefined ? "–" : Number(value.toPrecision(4)).toString());

export class Tunnels {
  constructor() {
    this.past = null; this.supposed = null; this.trials = []; this.view = null; this.hidden = new Set(); this.at = null;
    element("past").oninput = (event) => this.look(Number(event.target.value));
    element("whole").onclick = () => this.zoom(null);
    element("save-table").onclick = () => save(new Blob([this.table.csv()], { type: "text/csv" }), "csv");
    element("save-picture").onclick = () => this.picture().toBlob((blob) => save(blob, "png"));
    this.forget();
  }

  // What is drawn: a trial gone by, one with a value moved, or what comes now.
  get table() { return this.past || this.supposed || this.live; }
  get moving() { return this.table === this.live; }
  get signals() { return this.table ? this.table.signals.filter((name) => !this.hidden.has(name)) : []; }

  // Everything will be sent again.
  forget() { this.live = null; this.past = null; this.supposed = null; this.forgetCharts(); }

  forgetCharts() {
    (this.charts || []).forEach((chart) => chart.destroy());
    this.charts = [];
    element("tunnels").replaceChildren();
    this.changed = true;
  }

  take(message) {
    if (!this.live || !this.live.holds(message)) {
      this.live = new Table(message);
      if (!this.past && !this.supposed) { this.view = null; this.forgetCharts(); }
    }
    this.live.fill(message, performance.now());
    this.changed = true;
  }

  // The trial with a value of the model moved, as the monitor sends it; null goes back to the live trial.
  suppose(trial) {
    const same = trial && this.supposed && this.supposed.holds({ ...trial, whole: false });
    if (!trial && !this.supposed) return;
    this.supposed = trial ? new Table(trial).fill(trial) : null;
    this.changed = true;
    if (!same) { this.past = null; this.view = null; this.forgetCharts(); this.draw(this.run, this.gap); }
  }

  // Past trials as [number, seconds since 1970]; the right end of the slider is live.
  keep(trials) {
    const slider = element("past"), now = !this.past;
    this.trials = trials;
    slider.max = trials.length;
    if (now) slider.value = trials.length;
    else slider.value = Math.max(0, trials.findIndex(([number]) => number === this.number));
    this.showPlace();
  }

  async look(place) {
    const entry = this.trials[place];
    if (!entry) { this.past = null; this.number = null; }
    else {
      this.number = entry[0];
      const answer = await fetch(`/trial/${entry[0]}`);
      if (this.number !== entry[0]) return; // another one was chosen in the meantime
      if (!answer.ok) return;
      const trial = await answer.json();
      this.past = new Table(trial).fill(trial);
    }
    this.forgetCharts();
    this.draw(this.run, this.gap);
  }

  showPlace() {
    const place = this.past ? this.trials.findIndex(([number]) => number === this.number) : -1;
    element("past-word").textContent = place < 0 ? "now" : `${place - this.trials.length} (until ${new Date(1000 * this.trials[place][1]).toLocaleTimeString()})`;
    element("past").disabled = !this.trials.length;
    element("whole").hidden = !this.view;
  }

  zoom(view) { this.view = view; this.changed = true; this.draw(this.run, this.gap); }

  // What the newest sample says: signal -> whether it is inside; null where nothing is known.
  now() {
    const live = this.live;
    if (!live || live.last < 0 || performance.now() - (live.fresh[live.last] || 0) > GLOW) return null;
    return Object.fromEntries(live.signals.map((name, s) => [name, live.columns[s][INSIDE][live.last] !== 0]));
  }

  draw(run, gap) {
    this.run = run; this.gap = gap;
    const table = this.table;
    const glowing = this.moving && table && table.last >= 0 && performance.now() - (table.fresh[table.last] || 0) < GLOW + 500;
    if (!this.changed && !glowing) return;
    this.changed = false;
    element("tunnel-tools").hidden = !table || !table.signals.length;
    this.showPlace();
    if (!table || !table.signals.length) { cleared(element("where"), 0); return; }
    if (!this.charts.length && this.signals.length) this.make();
    this.charts.forEach((chart, i) => {
      const c = table.columns[this.drawn[i]];
      chart.setData([c[0], c[UPPER], c[LOWER], c[MEAN], c[BEFORE], c[SIMULATED]]);
    });
    const known = !this.past && gap && String(gap.signals) === String(table.signals);
    this.shares.forEach((share, i) => {
      if (this.at !== null) return; // the cursor's values stand there
      const rig = known ? (gap.rig_shares[this.drawn[i]] || [])[0] : undefined;
      const itself = rig === undefined || rig === null ? "" : `, the rig against itself ${percent(rig)}`;
      share.textContent = known && !table.collecting ? `${percent(gap.shares[this.drawn[i]][0])} alike${itself}` : "";
    });
    const band = table.collecting ? "Collecting: one real trial has no width yet, so nothing is judged."
      : "The band is the spread of the real trials; red is where the simulation leaves it.";
    element("tunnel-what").textContent = this.past ? `A past trial. ${band}` : this.supposed ? `Simulated with the changed value; dashed: the model as it is. ${band}` : run ? `${run.sequence}, trial ${run.trial + 1} of ${run.trials}. ${band}` : band;
    this.drawWhere();
  }

  make() {
    const table = this.table;
    element("signals").replaceChildren(...table.signals.map((name) => {
      const button = document.createElement("button");
      button.textContent = name; button.setAttribute("aria-pressed", String(!this.hidden.has(name)));
      button.onclick = () => {
        if (!this.hidden.delete(name) && this.signals.length > 1) this.hidden.add(name);
        this.forgetCharts(); this.draw(this.run, this.gap);
      };
      return button;
    }));
    this.drawn = this.signals.map((name) => table.signals.indexOf(name)); // column of each chart
    // All boxes first: how wide one is depends on how many there are.
    const boxes = this.signals.map((name) => {
      const [box, head, title, share] = ["div", "div", "b", "span"].map((tag) => document.createElement(tag));
      head.className = "name"; title.textContent = `${name}, ${unitOf(name)[0]}`;
      head.append(title, share); box.append(head);
      return box;
    });
    element("tunnels").replaceChildren(...boxes);
    this.shares = boxes.map((box) => box.firstElementChild.lastElementChild);
    this.charts = boxes.map((box, i) => new uPlot({
      width: box.clientWidth, height: HEIGHT, legend: { show: false }, padding: [6, 14, 0, 0],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false }, sync: { key: "tunnels" }, bind: { dblclick: () => () => { this.zoom(null); return null; } } },
      scales: {
        x: { time: false, range: () => this.view || [0, table.end] },
        y: { range: (u, low, high) => { const pad = 0.08 * Math.max(high - low, 0.2); return [low - pad, high + pad]; } },
      },
      axes: [{ ...AXIS(), values: (u, all) => all.map((t) => `${Number(t.toPrecision(4))} s`), size: 24 }, { ...AXIS(), size: 40 }],
      bands: [{ series: [1, 2], fill: colour("tunnel") }],
      series: [{}, { stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } },
        { stroke: colour(table.collecting ? "muted" : "real"), width: 1.2, points: { show: false } },
        { stroke: colour("before"), width: 1.2, dash: [5, 4], points: { show: false } },
        { stroke: colour(table.collecting ? "muted" : "sim"), width: 1.8, points: { show: false } }],
      hooks: {
        drawClear: [(u) => this.drawOutside(u, this.drawn[i])],
        setCursor: [(u) => this.point(i, u.cursor.idx)],
        setSelect: [(u) => this.select(u)],
      },
    }, [[], [], [], [], [], []], box));
    this.wasCollecting = table.collecting;
  }

  // A stretch of time was dragged over in one chart: all show it.
  select(u) {
    const { left, width } = u.select;
    if (width < 4) return;
    this.zoom([u.posToVal(left, "x"), u.posToVal(left + width, "x")]);
    this.charts.forEach((chart) => chart.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false));
  }

  // Values at the cursor, above each chart.
  point(i, row) {
    this.at = row === null || row === undefined ? null : row;
    if (this.at === null) { this.changed = true; return; }
    const c = this.table.columns[this.drawn[i]], from = shown(c[LOWER][row]), to = shown(c[UPPER][row]);
    this.shares[i].textContent = `${shown(c[0][row])} s: real ${shown(c[MEAN][row])} (${from} to ${to}), simulated ${shown(c[SIMULATED][row])}`;
  }

  drawOutside(u, s) {
    const table = this.table;
    if (table.collecting !== this.wasCollecting) { this.wasCollecting = table.collecting; queueMicrotask(() => { this.forgetCharts(); this.draw(this.run, this.gap); }); }
    const context = u.ctx;
    context.save();
    context.beginPath(); context.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); context.clip();
    for (const [first, last] of table.outside(s)) {
      const left = u.valToPos((first - 0.5) * table.step, "x", true), right = u.valToPos((last + 0.5) * table.step, "x", true);
      context.fillStyle = colour("outside");
      context.fillRect(left, u.bbox.top, Math.max(right - left, 1), u.bbox.height);
    }
    const age = this.moving && table.last >= 0 ? performance.now() - (table.fresh[table.last] || 0) : GLOW;
    if (age < GLOW) {
      const x = u.valToPos(table.last * table.step, "x", true), failed = table.columns[s][INSIDE][table.last] === 0;
      context.globalAlpha = 1 - age / GLOW;
      context.fillStyle = failed ? colour("glow") : colour("muted");
      context.fillRect(x - 1, u.bbox.top, failed ? 4 : 2, u.bbox.height);
    }
    context.restore();
  }

  drawWhere() {
    const table = this.table, row = 15, canvas = element("where"), label = 84;
    const [context, width] = cleared(canvas, table.signals.length * row + 2);
    const rows = Math.max(table.columns[0][0].length, Math.round(table.duration / table.step)), scale = (width - label) / rows, clock = performance.now();
    context.font = "11px system-ui, sans-serif"; context.textBaseline = "middle";
    table.signals.forEach((name, s) => {
      const y = s * row;
      context.fillStyle = colour("muted"); context.fillText(name, 0, y + row / 2);
      context.fillStyle = colour("grid"); context.fillRect(label, y + 2, width - label, row - 4);
      const inside = table.columns[s][INSIDE];
      context.globalAlpha = 0.35;
      for (let i = 0; i < inside.length; i++) {
        if (inside[i] !== 1 && inside[i] !== COLLECTING) continue;
        context.fillStyle = colour(inside[i] === 1 ? "real" : "muted");
        context.fillRect(label + i * scale, y + 2, scale + 0.5, row - 4);
      }
      for (const [first, last, newest] of table.outside(s)) {
        const glow = newest ? Math.max(0, 1 - (clock - newest) / GLOW) : 0;
        context.globalAlpha = 0.6 + 0.4 * glow;
        context.fillStyle = colour("glow");
        context.fillRect(label + first * scale, y + 2 - glow, Math.max((last + 1 - first) * scale, 1.5), row - 4 + 2 * glow);
      }
      context.globalAlpha = 1;
    });
  }

  // All charts one below the other, with their names, on the page's background.
  picture() {
    const canvases = this.charts.map((chart) => chart.ctx.canvas), ratio = devicePixelRatio || 1, head = 22 * ratio;
    const canvas = document.createElement("canvas"), context = canvas.getContext("2d");
    canvas.width = Math.max(...canvases.map((c) => c.width));
    canvas.height = canvases.reduce((sum, c) => sum + c.height + head, 0);
    context.fillStyle = colour("page"); context.fillRect(0, 0, canvas.width, canvas.height);
    let top = 0;
    canvases.forEach((source, i) => {
      const name = this.table.signals[this.drawn[i]];
      context.fillStyle = colour("text"); context.font = `${13 * ratio}px system-ui, sans-serif`;
      context.fillText(`${name}, ${unitOf(name)[0]}`, 8 * ratio, top + 15 * ratio);
      context.drawImage(source, 0, top + head);
      top += head + source.height;
    });
    return canvas;
  }
}

function save(blob, ending) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `tunnels_${new Date().toISOString().replace(/[:.]/g, "-").slice(0, 19)}.${ending}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
