// SPDX-License-Identifier: Apache-2.0
// Alikeness over the factor k by which reality's tunnel is widened.
import { AXIS, colour } from "/static/colours.js";

const COLOURS = ["s1", "s2", "s3", "s4"];
let chart = null, shape = "";

export const percent = (share) => (share === null || share === undefined ? "–" : `${(100 * share).toFixed(share < 0.995 ? 1 : 0)} %`);

export function drawGap(gap, before, staircase, anew = false) {
  if (!gap) return;
  const joint = gap.joint[0];
  const collecting = gap.trials < 2, number = document.getElementById("joint");
  number.textContent = collecting ? "collecting" : percent(joint);
  number.classList.toggle("collecting", collecting);
  document.getElementById("joint-what").textContent = collecting ? "one real trial so far: two give the tunnel a width, five are better" :
    `of ${gap.samples} samples are alike in all ${gap.signals.length} signals at k = ${gap.ks[0]}: ${gap.model || "the model"} against ${gap.trials} real trial${gap.trials === 1 ? "" : "s"}`;
  const older = before && before.model !== gap.model ? before : null;
  document.getElementById("joint-before").textContent = older ? `before, with ${older.model}: ${percent(older.joint[0])}` : "";
  const rows = [...gap.shares, gap.joint];
  const rig = gap.rig.map((v) => (v === null ? null : 100 * v)), known = rig.length === gap.ks.length;
  document.getElementById("joint-rig").textContent = known ? `the rig against itself: ${percent(gap.rig[0])}`
    : "the rig against itself: known after three trials";
  const data = [gap.ks, ...rows.map((row) => row.map((v) => (v === null || collecting ? null : 100 * v))),
    gap.ks.map((k) => { const i = older ? older.ks.indexOf(k) : -1; return i < 0 || older.joint[i] === null ? null : 100 * older.joint[i]; }),
    known ? rig : gap.ks.map(() => null)];
  const target = document.getElementById("over-k");
  const now = JSON.stringify([gap.signals, gap.ks, target.clientWidth]);
  if (anew || now !== shape) {
    shape = now;
    if (chart) chart.destroy();
    chart = new uPlot({
      width: target.clientWidth, height: 160, cursor: { show: false }, legend: { show: false }, padding: [8, 16, 0, 0],
      scales: { x: { time: false, range: (u, low, high) => [low, high === low ? low + 1 : high] }, y: { range: [0, 102] } },
      axes: [{ ...AXIS(), splits: () => gap.ks, values: (u, ks) => ks.map((k) => `k = ${k}`), size: 26 },
        { ...AXIS(), values: (u, all) => all.map((v) => `${v} %`), size: 44 }],
      series: [{}, ...gap.signals.map((_, i) => ({ stroke: colour(COLOURS[i % 4]), width: 1.5, points: { show: true, size: 4 } })),
        { stroke: colour("text"), width: 2.5, points: { show: true, size: 6, fill: colour("text") } },
        { stroke: colour("before"), width: 2, dash: [5, 4], points: { show: false } },
        { stroke: colour("real"), width: 2, dash: [2, 3], points: { show: false } }],
    }, data, target);
  } else chart.setData(data);
  const legend = document.getElementById("k-legend");
  legend.replaceChildren(...gap.signals.map((name, i) => item(name, colour(COLOURS[i % 4]))), item("jointly", colour("text")),
    ...(known ? [item("the rig against itself", colour("real"), true)] : []), ...(older ? [item(`jointly, ${older.model}`, colour("before"), true)] : []));
}

function item(name, stroke, dashed = false) {
  const span = document.createElement("span"), line = document.createElement("i");
  line.style.borderTopColor = stroke;
  if (dashed) line.style.borderTopStyle = "dashed";
  span.append(line, name);
  return span;
}
