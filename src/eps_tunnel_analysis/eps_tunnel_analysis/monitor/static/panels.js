// SPDX-License-Identifier: Apache-2.0
// Words, buttons and bars.
import { percent } from "/static/gap.js";
import { shownUnit } from "/static/table.js";

const element = (id) => document.getElementById(id);
const PARTS = [["real", "Rig"], ["sim", "Simulation"], ["player", "Player"], ["analysis", "Analysis"]];
const DOING = { play: "Playing", diagnose: "Diagnosing", add: "Adding" };
let choices = [], offered = "", noticed = -1, noticeEnds = 0;

function make(tag, text = "", className = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

export function showChoices(offer) {
  const select = element("sequence"), chosen = select.value;
  choices = offer.sequences;
  select.replaceChildren(...choices.map(([name]) => {
    const short = name.replace(/\.yaml$/, "").split("/").slice(-2).join("/");
    const option = make("option", name.startsWith("/") ? `proposed: ${short}` : name);
    option.value = name;
    return option;
  }));
  const names = choices.map(([name]) => name);
  select.value = names.includes(chosen) ? chosen : names.includes("excite_12s") ? "excite_12s" : names[0] || "";
  if (names[0] && names[0].startsWith("/") && names[0] !== offered) { offered = names[0]; select.value = offered; }
  describe();
  select.onchange = describe;
}

function describe() {
  const chosen = choices.find(([name]) => name === element("sequence").value);
  element("about").textContent = chosen ? `${chosen[1]} ${chosen[3].toFixed(0)} s a trial.` : "";
}

export function showControls({ connections: there, job, run, verdict, rig }) {
  if (!there || !job) return;
  element("chips").replaceChildren(...PARTS.map(([key, name]) => make("span", name, there[key] ? "chip there" : "chip")),
    make("span", there.model ? `model ${there.model}` : ""));
  const armed = element("armed");
  armed.checked = there.armed;
  element("armed-word").textContent = there.armed ? "Armed" : "Not armed";
  const busy = job.kind !== "";
  element("play").disabled = busy || !there.armed || !there.player;
  element("diagnose").disabled = busy;
  element("add").disabled = busy;
  for (const id of ["what-if-name", "what-if-value"]) element(id).disabled = job.kind === "play";
  element("stop").disabled = !busy;
  const missing = PARTS.filter(([key]) => !there[key]).map(([, name]) => name.toLowerCase());
  element("hint").textContent = missing.length ? `Not running: ${missing.join(", ")}.` : !there.armed && !busy ? "Arm the rig to play: it will move." : "";
  const panel = element("job"), meter = panel.querySelector(".meter"), words = panel.querySelector("p");
  panel.hidden = !busy;
  if (!busy) return;
  const playing = job.kind === "play" && run;
  meter.classList.toggle("busy", !playing);
  meter.firstElementChild.style.width = playing ? `${100 * run.share}%` : "";
  words.textContent = playing ? `Trial ${run.trial + 1} of ${run.trials}, ${run.phase}; ${run.time_left.toFixed(0)} s left`
    : `${DOING[job.kind]}, ${job.seconds.toFixed(0)} s: ${job.progress}`;
}

// An error in the rig's SI unit, as people read it.
const inWords = (value, si) => { const [unit, factor] = shownUnit(si); return `${(value * factor).toFixed(3)} ${unit}`; };

// Errors are in `si`, the rig's unit.
export function showVerdict(verdict, si) {
  element("sentence").textContent = verdict.sentence;
  const shown = verdict.hypotheses.filter(([, p, stated]) => stated || p >= 0.001).sort((a, b) => b[1] - a[1]).slice(0, 6);
  element("hypotheses").replaceChildren(...shown.map(([name, p, stated]) => {
    const row = make("div", "", stated ? "hypothesis" : "hypothesis out"), meter = make("div", "", "meter"), bar = make("i");
    bar.style.width = `${100 * p}%`;
    meter.append(bar);
    row.append(make("b", name), meter, make("span", percent(p)));
    return row;
  }));
  const names = [...new Set([verdict.effects.join(" + "), ...shown.map(([name]) => name)])].filter((n) => n && n !== "none" && n !== "unknown");
  element("adding").hidden = !names.length;
  element("effect").replaceChildren(...names.map((name) => { const option = make("option", name); option.value = name; return option; }));
  const more = element("verdict-more");
  const [given, refitted, after] = verdict.held_out;
  const errors = [[given, "as given"], [refitted, "with values refitted"], [verdict.effects.length ? after : null, "with the effect"]].filter(([v]) => v !== null);
  const lines = errors.length ? [`Error on held-out samples: ${errors.map(([v, when]) => `${inWords(v, si)} ${when}`).join(", ")}.`] : [];
  const where = verdict.where.filter(([signal]) => signal !== "jointly").sort((a, b) => (b[2] - b[1]) - (a[2] - a[1])).slice(0, 3);
  if (where.length) lines.push(`Longest outside the tunnel, values refitted: ${where.map(([signal, start, end]) => `${signal} ${start.toFixed(2)} to ${end.toFixed(2)} s`).join(", ")}.`);
  if (verdict.next_experiment) lines.push("Next: play the proposed sequence, the first in the list.");
  more.replaceChildren(...[...lines, ...verdict.notes].map((line) => make("p", line)));
  if (verdict.report) {
    const link = make("a", "Report with the evidence");
    link.href = verdict.report; link.target = "_blank"; link.rel = "noopener";
    more.append(link);
  }
}

export function showStairs(steps, si) {
  const worst = Math.max(...steps.map((s) => s.held_out || 0), 1e-9);
  element("stairs").replaceChildren(...steps.map((step) => {
    const row = make("div", "", "step"), name = make("div");
    name.append(make("b", step.change), make("span", step.model, "quiet"));
    row.append(name,
      value(step.held_out === null ? null : step.held_out / worst, step.held_out === null ? "no error yet" : inWords(step.held_out, si), "error"),
      value(step.live, step.live === null ? "not played" : `${percent(step.live)} alike`, ""));
    return row;
  }));
}

function value(share, words, kind) {
  const box = make("div", "", "value"), bar = make("div", "", "bar"), fill = make("i", "", kind);
  fill.style.width = `${100 * (share || 0)}%`;
  bar.append(fill);
  box.append(bar, make("span", words));
  return box;
}

export function showLog(entries) {
  element("log").replaceChildren(...[...entries].reverse().map(([, at, level, text]) => {
    const line = make("li", "", level), time = make("time", new Date(1000 * at).toLocaleTimeString());
    line.append(time, text);
    return line;
  }));
  const newest = entries[entries.length - 1];
  if (newest && newest[0] > noticed) {
    if (newest[2] === "error" && Date.now() / 1000 - newest[1] < 30) showNotice(newest[3]);
    else element("notice").hidden = true;
    noticed = newest[0];
  }
}

export function showNotice(text) {
  const notice = element("notice");
  notice.textContent = text;
  notice.hidden = false;
  noticeEnds = Date.now() + 12000;
  setTimeout(() => { if (Date.now() >= noticeEnds) notice.hidden = true; }, 12100);
}

const MOST_TROUBLED = 0.02; // share of late and lost samples from which a banner reports it

export function showHealth(h) {
  const banner = element("troubled");
  banner.hidden = !(h.troubled > MOST_TROUBLED);
  banner.textContent = `${percent(h.troubled)} of the latest samples arrived late or were lost: the display may be wrong. Check for a busy machine or a weak network.`;
  const troubles = [["late", h.late], ["lost", h.lost], ["out of order", h.reordered], ["duplicated", h.duplicated], ["restarts", h.restarts], ["clock jumps", h.clock_jumps]];
  const problems = troubles.filter(([, n]) => n).map(([name, n]) => `${n} ${name}`);
  element("health").textContent = `${h.received.toLocaleString("en")} samples received${problems.length ? `; ${problems.join(", ")}` : ", all in order"}.`;
}
