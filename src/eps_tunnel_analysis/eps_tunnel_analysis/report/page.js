// SPDX-License-Identifier: Apache-2.0
// Draws the page's charts in the page's colours, and draws them again when k, the colour scheme or the width changes.
(() => {
  const charts = [...document.querySelectorAll(".chart")].map((node) => ({
    node, figure: JSON.parse(node.nextElementSibling.textContent), plot: null, width: 0,
  }));
  for (const { figure } of charts) { // an even grid comes by its start and step
    const { from, step, count } = figure.x;
    if (count) figure.x = Array.from({ length: count }, (_, i) => Number((from + i * step).toPrecision(10)));
  }
  let k = document.querySelector(".k-picker button")?.dataset.k ?? "1";
  const coarse = matchMedia("(pointer: coarse)").matches; // a finger scrolls the page

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const shown = (value) => (value === null || value === undefined ? "–" : Number(value.toPrecision(4)).toString());

  const columns = ({ x, lines, band }) => {
    const edge = (side) => band[side].map((d, i) => (d === null || band.centre[i] === null ? null : band.centre[i] + Number(k) * d));
    return [x, ...(band ? [edge("lower"), edge("upper")] : []), ...lines.map((line) => line.y)];
  };

  const shade = (plot, spans) => {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.fillStyle = colour("outside");
    for (const [start, end] of spans) {
      const left = plot.valToPos(start, "x", true), right = plot.valToPos(end, "x", true);
      ctx.fillRect(left, bbox.top, Math.max(right - left, 1), bbox.height);
    }
    ctx.restore();
  };

  const bars = (plot, figure, first) => {
    const { ctx } = plot;
    figure.lines.forEach((line, i) => {
      if (!line.spread) return;
      ctx.save();
      ctx.strokeStyle = colour(line.colour); ctx.globalAlpha = 0.4; ctx.lineWidth = 1;
      ctx.beginPath();
      plot.data[first + i].forEach((y, n) => {
        if (y === null || line.spread[n] === null) return;
        const x = plot.valToPos(figure.x[n], "x", true);
        ctx.moveTo(x, plot.valToPos(y - line.spread[n], "y", true)); ctx.lineTo(x, plot.valToPos(y + line.spread[n], "y", true));
      });
      ctx.stroke(); ctx.restore();
    });
  };

  const draw = (chart) => {
    const { node, figure } = chart, view = chart.plot && chart.zoomed ? { ...chart.plot.scales.x } : null;
    chart.plot?.destroy();
    chart.width = node.clientWidth;
    const { fontFamily } = getComputedStyle(document.body), font = `12px ${fontFamily}`;
    const axis = { stroke: colour("muted"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, font, labelFont: font, labelSize: 20 };
    const edge = (label) => ({ label, stroke: "transparent", width: 0, points: { show: false }, value: (_, v) => shown(v) });
    const first = figure.band ? 3 : 1, ends = [figure.x[0], figure.x[figure.x.length - 1]];
    chart.plot = new uPlot({
      width: chart.width, height: figure.height, padding: [10, 12, 0, 0],
      cursor: { y: false, drag: { x: !coarse, y: false }, ...(figure.together ? { sync: { key: figure.together } } : {}) },
      legend: { live: true },
      scales: { x: { time: false }, y: figure.yRange ? { range: figure.yRange } : {} },
      axes: [{ ...axis, label: figure.xLabel, size: 26 }, { ...axis, label: figure.yLabel, size: 52 }],
      bands: figure.band ? [{ series: [2, 1], fill: colour("tunnel") }] : [],
      series: [
        { label: figure.xLabel, value: (_, v) => shown(v) },
        ...(figure.band ? [edge(`${figure.band.name}, from`), edge("to")] : []),
        ...figure.lines.map((line) => ({
          label: line.name, stroke: colour(line.colour), width: line.width, dash: line.dash ? [4, 4] : undefined, value: (_, v) => shown(v),
          points: { show: line.points || line.width === 0, size: line.width ? 6 : 3, fill: colour(line.colour), stroke: colour(line.colour) },
          paths: line.width === 0 ? () => null : line.steps ? uPlot.paths.stepped({ align: 1 }) : undefined,
        })),
      ],
      hooks: {
        drawClear: [(plot) => shade(plot, figure.outside[k] ?? [])],
        draw: [(plot) => bars(plot, figure, first)],
        setScale: [(plot, key) => { if (key === "x") chart.zoomed = plot.scales.x.min > ends[0] || plot.scales.x.max < ends[1]; }],
      },
    }, columns(figure), node);
    if (view) chart.plot.setScale("x", { min: view.min, max: view.max });
    node.dataset.drawn = figure.lines.length;
  };

  const drawAll = () => charts.forEach(draw);
  for (const button of document.querySelectorAll(".k-picker button")) {
    button.addEventListener("click", () => {
      k = button.dataset.k;
      for (const other of document.querySelectorAll(".k-picker button")) other.setAttribute("aria-pressed", String(other.dataset.k === k));
      charts.filter(({ figure }) => figure.band).forEach(({ plot, figure, zoomed }) => plot.setData(columns(figure), !zoomed));
      charts.forEach(({ plot }) => plot.redraw());
    });
  }
  for (const button of document.querySelectorAll(".command button")) {
    button.addEventListener("click", async () => {
      const code = button.parentElement.querySelector("code");
      try { await navigator.clipboard.writeText(code.textContent); button.textContent = "Copied"; } catch { // not allowed here
        getSelection().selectAllChildren(code); button.textContent = "Selected";
      }
    });
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  for (const fold of document.querySelectorAll("details")) fold.addEventListener("toggle", () => charts.filter(({ node }) => fold.contains(node)).forEach(draw));
  addEventListener("resize", () => charts.filter(({ node, width }) => node.clientWidth !== width).forEach(draw));
  drawAll();
})();
