// SPDX-License-Identifier: Apache-2.0
// The slider over one value of the model: the last command of the last run is simulated again with it.
import { percent } from "/static/gap.js";

const PAUSE = 50; // ms between two requests while the slider moves
const PARTS = 200; // of the slider's range
const element = (id) => document.getElementById(id);
const short = (value) => Number(value.toPrecision(4)).toString();
const unit = (name) => (name === "1" ? "" : ` ${name}`);
let offered = [], due = 0;

function option(value, text) {
  const made = document.createElement("option");
  made.value = value; made.textContent = text;
  return made;
}

// Values that can be moved; `ask` sends a request.
export function offerValues(values, ask) {
  offered = values;
  const select = element("what-if-name"), slider = element("what-if-value");
  const groups = [[true, "the model's values"], [false, "effects that it lacks"]].map(([held, label]) => {
    const group = document.createElement("optgroup");
    group.label = label;
    group.append(...values.filter((v) => v.held === held).map((v) => option(v.name, v.name)));
    return group;
  });
  select.replaceChildren(option("", "none"), ...groups);
  range("");
  element("what-if-card").hidden = !values.length;
  select.onchange = () => { range(select.value); ask({ do: "what_if", name: select.value, value: null }); };
  slider.oninput = () => {
    if (due) return;
    due = setTimeout(() => { due = 0; if (select.value) ask({ do: "what_if", name: select.value, value: Number(slider.value) }); }, PAUSE);
  };
}

function range(name) {
  const slider = element("what-if-value"), chosen = offered.find((v) => v.name === name);
  element("what-if-slider").hidden = !chosen;
  if (!chosen) return;
  slider.min = chosen.low; slider.max = chosen.high; slider.step = (chosen.high - chosen.low) / PARTS;
  slider.value = chosen.given;
  element("what-if-ends").textContent = `${short(chosen.low)} to ${short(chosen.high)}${unit(chosen.unit)}`;
}

// The monitor's answer; nothing if no value is changed.
export function showWhatIf(answer) {
  const select = element("what-if-name"), slider = element("what-if-value"), name = answer && answer.gap ? answer.name : "";
  if (select.value !== name || !name) { select.value = name; range(name); }
  element("what-if-word").textContent = "";
  if (!name) return;
  if (document.activeElement !== slider) slider.value = answer.value;
  const joint = percent(answer.gap.joint[0]), k = answer.gap.ks[0];
  const itself = answer.gap.rig.length ? `; the rig against itself ${percent(answer.gap.rig[0])}` : "";
  element("what-if-word").textContent = answer.before
    ? `${short(answer.value)}${unit(answer.unit)} instead of ${short(answer.given)}: ${joint} alike at k = ${k}, ${percent(answer.before.joint[0])} as it is${itself}`
    : `${short(answer.given)}${unit(answer.unit)} in the model: ${joint} alike at k = ${k}${itself}`;
}
