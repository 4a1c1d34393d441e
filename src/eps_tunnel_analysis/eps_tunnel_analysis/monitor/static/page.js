// SPDX-License-Identifier: Apache-2.0
// Keeps the connection, hands each part to its panel, and sends what is asked for.
import { drawBoard } from "/static/board.js";
import { drawGap } from "/static/gap.js";
import { learnUnits } from "/static/table.js";
import { Tunnels } from "/static/tunnels.js";
import { offerValues, showWhatIf } from "/static/what_if.js";
import { showChoices, showControls, showHealth, showLog, showNotice, showStairs, showVerdict } from "/static/panels.js";

const SLOWEST = 5000; // ms between two attempts to connect
const SILENCE = 4000; // ms; an open but silent connection is closed and made anew

const known = {}; // the newest of every part
const tunnels = new Tunnels();
let socket = null, delay = 250, heard = 0;

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  heard = performance.now();
  socket.onopen = () => { delay = 250; document.getElementById("away").hidden = true; tunnels.forget(); forgetWhatIf(); };
  socket.onmessage = (event) => { heard = performance.now(); take(JSON.parse(event.data)); };
  socket.onclose = () => {
    const away = document.getElementById("away");
    away.hidden = false;
    away.textContent = "The monitor does not answer. Reconnecting…";
    fetch("/static/icon.svg", { cache: "no-store" }).then((answer) => {
      if (answer.status === 403) away.textContent = "The monitor runs with another token. Open the address that it printed.";
    }, () => {});
    if (known.connections) { // what was there last is not known to be there now
      known.connections = { ...known.connections, real: false, sim: false, player: false, analysis: false, armed: false };
      known.job = { kind: "", progress: "", seconds: 0 };
      showControls(known);
    }
    setTimeout(connect, delay);
    delay = Math.min(2 * delay, SLOWEST);
    draw();
  };
}

function take(news) {
  if (news.refused) { showNotice(news.refused); return; }
  Object.assign(known, news);
  const si = known.rig ? known.rig.unit : "rad";
  if (news.rig) learnUnits(news.rig.units);
  if (news.tunnel) tunnels.take(news.tunnel);
  if (news.past) tunnels.keep(news.past.trials);
  if (news.choices) showChoices(news.choices);
  if (news.verdict || (news.rig && known.verdict)) showVerdict(known.verdict, si);
  if (news.staircase || (news.rig && known.staircase)) showStairs(known.staircase.steps, si);
  if (news.log) showLog(news.log.entries);
  if (news.health) showHealth(news.health);
  if (news.adjustables) offerValues(news.adjustables.values, ask);
  if (news.whatif) takeWhatIf(news.whatif);
  if (news.gap || news.before || news.whatif) showGap();
  if (news.connections || news.job || news.run || news.verdict || news.gap) showControls(known);
  draw();
}

// The gap of a value that is moved stands where that of the model is shown.
function showGap(anew = false) {
  const moved = known.whatif && known.whatif.gap;
  drawGap(moved || known.gap, moved ? known.whatif.before : known.before, known.staircase, anew);
}

async function takeWhatIf(shown) {
  showWhatIf(shown);
  if (!shown.gap) { tunnels.suppose(null); return; }
  const answer = await fetch("/what_if");
  if (!answer.ok) return;
  const table = await answer.json();
  if (!known.whatif || table.number !== known.whatif.number) return; // another value was chosen in the meantime
  tunnels.suppose(table);
  draw();
}

function forgetWhatIf() {
  known.whatif = null;
  offerValues([], ask);
  showWhatIf(null);
  tunnels.suppose(null);
}

let due = false;
function draw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    tunnels.draw(known.run, (known.whatif && known.whatif.gap) || known.gap);
    drawBoard(known.rig, known.scene, tunnels.now());
  });
}

export function ask(request) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(request));
  else showNotice("Not connected; nothing was sent.");
}

function again() {
  tunnels.forgetCharts();
  showGap(true);
  draw();
}

document.getElementById("play").onclick = () => ask({
  do: "play", sequence: document.getElementById("sequence").value, trials: Number(document.getElementById("trials").value),
});
document.getElementById("stop").onclick = () => ask({ do: "stop" });
document.getElementById("diagnose").onclick = () => ask({ do: "diagnose" });
document.getElementById("add").onclick = () => ask({ do: "add", names: document.getElementById("effect").value.split(" + ") });
document.getElementById("armed").onchange = (event) => ask({ do: "arm", on: event.target.checked });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
let width = innerWidth;
addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; again(); } });
setInterval(() => { if (socket.readyState === WebSocket.OPEN && performance.now() - heard > SILENCE) socket.close(); }, 1000);
addEventListener("online", () => { delay = 250; });
if (location.search) history.replaceState(null, "", "/"); // the cookie shows the token from now on
connect();
