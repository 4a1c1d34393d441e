// SPDX-License-Identifier: Apache-2.0
// Draws the page's charts in the page's colours and redraws them when k, the colour scheme or the width changes.
(() => {
  const charts = [...document.querySelectorAll(".chart")].map((node) => ({
    node,
    figure: JSON.parse(node.nextElementSibling.textContent),
  }));
  let k = document.querySelector(".k-picker button")?.dataset.k ?? "1";

  const coloured = (value) => {
    if (typeof value === "string" && value.startsWith("var(")) {
      return getComputedStyle(document.documentElement).getPropertyValue(value.slice(4, -1)).trim();
    }
    if (Array.isArray(value)) return typeof value[0] === "number" ? value : value.map(coloured);
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, coloured(inner)]));
    }
    return value;
  };

  const widened = (trace) => {
    if (!trace.meta?.deviation) return trace;
    const { centre, deviation } = trace.meta;
    return { ...trace, y: deviation.map((d, i) => (d === null || centre[i] === null ? null : centre[i] + Number(k) * d)) };
  };

  const draw = ({ node, figure }) => {
    const axis = { gridcolor: "var(--grid)", zerolinecolor: "var(--line)", linecolor: "var(--line)", automargin: true };
    const layout = structuredClone(figure.layout);
    for (const name of Object.keys(layout).filter((key) => /^[xy]axis/.test(key))) {
      layout[name] = { ...axis, ...layout[name] };
    }
    const spans = figure.outside[k] ?? [];
    if (spans.length) { // one path for all: hundreds of shapes would be slow
      const path = spans.map(([a, b]) => `M${a},0L${b},0L${b},1L${a},1Z`).join("");
      layout.shapes = [{ type: "path", xref: "x", yref: "paper", path, fillcolor: "var(--outside)", line: { width: 0 }, layer: "below" }];
    }
    const view = node.layout ?? {};
    for (const name of Object.keys(layout).filter((key) => /^[xy]axis/.test(key))) {
      if (view[name] && view[name].autorange === false) layout[name].range = view[name].range;
    }
    const style = getComputedStyle(document.body);
    Plotly.react(node, coloured(figure.data.map(widened)), coloured({
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: style.fontFamily, size: 12.5, color: style.color },
      margin: { l: 8, r: 8, t: 8, b: 8 }, hovermode: "x unified",
      dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom", // a finger scrolls the page
      hoverlabel: { bgcolor: "var(--card)", bordercolor: "var(--line)" },
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" },
      ...layout,
    }), { responsive: true, displayModeBar: false });
  };

  const drawAll = () => charts.forEach(draw);
  for (const button of document.querySelectorAll(".k-picker button")) {
    button.addEventListener("click", () => {
      k = button.dataset.k;
      for (const other of document.querySelectorAll(".k-picker button")) {
        other.setAttribute("aria-pressed", String(other.dataset.k === k));
      }
      drawAll();
    });
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  drawAll();
})();
