// SPDX-License-Identifier: Apache-2.0
// Colours of the style sheet for what is drawn on canvases, and canvases at the screen's own resolution.

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// The 2D context of a canvas of this height in px, cleared, in units of px; and its width.
export function cleared(canvas, height) {
  const ratio = devicePixelRatio || 1, width = canvas.parentElement.clientWidth
    - parseFloat(getComputedStyle(canvas.parentElement).paddingLeft) - parseFloat(getComputedStyle(canvas.parentElement).paddingRight);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w; canvas.height = h;
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width];
}

export const AXIS = () => ({
  stroke: colour("muted"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif", gap: 3,
});
