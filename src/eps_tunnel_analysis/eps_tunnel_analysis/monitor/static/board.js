// SPDX-License-Identifier: Apache-2.0
// The board and the ball from above, and where every axis is, real and simulated.
import { cleared, colour } from "/static/colours.js";
import { unitOf } from "/static/table.js";

const TRAIL = 25; // positions of each ball that are remembered
const trails = { real: [], sim: [] };

export function drawBoard(rig, scene, inside) {
  const canvas = document.getElementById("board");
  canvas.hidden = !(rig && rig.floor);
  if (rig && scene) drawAngles(rig, scene, inside);
  if (canvas.hidden || !scene) return;
  const { size, walls, holes, hole_radius: hole, ball_radius: ball } = rig.floor, edge = 0.01;
  const shown = canvas.parentElement.clientWidth - 34;
  if (shown <= 0) return; // not laid out yet
  const scale = Math.min(shown, 620) / (size[0] + 2 * edge);
  const [context, width] = cleared(canvas, (size[1] + 2 * edge) * scale);
  const left = (width - size[0] * scale) / 2;
  const X = (x) => left + x * scale, Y = (y) => (size[1] + edge - y) * scale;
  context.fillStyle = colour("floor");
  context.fillRect(X(0), Y(size[1]), size[0] * scale, size[1] * scale);
  context.fillStyle = colour("hole");
  for (const [x, y] of holes) disc(context, X(x), Y(y), hole * scale);
  context.fillStyle = colour("wall");
  for (const [x0, x1, y0, y1] of walls) context.fillRect(X(x0), Y(y1), (x1 - x0) * scale, (y1 - y0) * scale);
  const unseen = ["real", "sim"].filter((side) => scene[side] && !scene[side].ball);
  document.getElementById("balls").textContent = unseen.length ? `Ball not seen: ${unseen.map((side) => (side === "real" ? "real" : "simulated")).join(", ")}.` : "";
  for (const side of ["sim", "real"]) {
    const pose = scene[side], stroke = colour(side);
    if (pose && pose.ball) {
      const trail = trails[side];
      trail.push(pose.ball);
      if (trail.length > TRAIL) trail.shift();
      trail.forEach(([x, y], i) => { context.globalAlpha = 0.3 * (i / TRAIL); context.fillStyle = stroke; disc(context, X(x), Y(y), 0.5 * ball * scale); });
      context.globalAlpha = 1;
      context.lineWidth = 2.5; context.strokeStyle = stroke; context.fillStyle = stroke;
      if (side === "real") disc(context, X(pose.ball[0]), Y(pose.ball[1]), ball * scale);
      else ring(context, X(pose.ball[0]), Y(pose.ball[1]), ball * scale);
    } else trails[side].length = 0;
    if (pose && rig.tilt) arrow(context, pose, rig, X(size[0] / 2), Y(size[1] / 2), 0.42 * size[1] * scale, stroke);
  }
  if (inside && Object.values(inside).includes(false)) {
    context.strokeStyle = colour("glow"); context.lineWidth = 4;
    context.strokeRect(X(0), Y(size[1]), size[0] * scale, size[1] * scale);
  }
}

// Where a ball would roll: a turn about x lowers the side of -y, one about y that of +x.
function arrow(context, pose, rig, x, y, reach, stroke) {
  const turns = rig.tilt.map((name) => pose.angles[name]);
  if (turns.some((turn) => turn === undefined || turn === null)) return;
  const dx = (turns[1] / rig.reach) * reach, dy = (turns[0] / rig.reach) * reach, length = Math.hypot(dx, dy);
  context.strokeStyle = stroke; context.fillStyle = stroke; context.lineWidth = 3; context.globalAlpha = 0.85;
  context.beginPath(); context.moveTo(x, y); context.lineTo(x + dx, y + dy); context.stroke();
  disc(context, x + dx, y + dy, length > 3 ? 5 : 4);
  context.globalAlpha = 1;
}

function drawAngles(rig, scene, inside) {
  const place = document.getElementById("angles");
  if (place.dataset.axes !== String(rig.axes)) {
    place.dataset.axes = String(rig.axes);
    place.replaceChildren(...rig.axes.flatMap(() => {
      const [name, scale, value] = ["span", "div", "span"].map((tag) => document.createElement(tag));
      const marks = ["real", "sim"].map((side) => { const mark = document.createElement("i"); mark.className = side; return mark; });
      scale.className = "scale"; scale.append(...marks);
      return [name, scale, value];
    }));
  }
  rig.axes.forEach((axis, i) => {
    const [name, scale, value] = [0, 1, 2].map((k) => place.children[3 * i + k]);
    const angles = ["real", "sim"].map((side) => (scene[side] ? scene[side].angles[axis] : undefined));
    name.textContent = axis;
    name.style.color = inside && inside[axis] === false ? colour("glow") : "";
    angles.forEach((angle, k) => {
      const mark = scale.children[k];
      mark.hidden = angle === undefined || angle === null;
      if (!mark.hidden) mark.style.left = `${50 + 50 * Math.max(-1, Math.min(1, angle / rig.reach))}%`;
    });
    const [unit, factor] = unitOf(axis);
    value.textContent = `${angles.map((a) => (a === undefined || a === null ? "–" : (a * factor).toFixed(1))).join(" / ")} ${unit}`;
  });
}

function disc(context, x, y, radius) { context.beginPath(); context.arc(x, y, radius, 0, 2 * Math.PI); context.fill(); }
function ring(context, x, y, radius) { context.beginPath(); context.arc(x, y, radius, 0, 2 * Math.PI); context.stroke(); }
