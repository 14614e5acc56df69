// Charts on canvases: curves over time, points of a learning curve, bars.

import { drawDisc, drawLine, fit } from "./shared.js";

const LEFT = 46;
const BOTTOM = 32;
const TOP = 8;
const RIGHT = 8;

/** Return round numbers that span an interval in about so many steps. */
function ticks(low, high, about) {
  const raw = (high - low) / about;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw * 0.999);
  const found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) found.push(value);
  return found.map((value) => ({ value, text: value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))) }));
}

function span(values, least) {
  const known = values.filter(Number.isFinite);
  if (!known.length) return [0, least];
  const [low, high] = [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))];
  const missing = Math.max(least - (high - low), 0.08 * (high - low));
  return [low - missing / 2, high + missing / 2];
}

/** Clear a canvas, draw its axes, with the title of x, and return where a point of the chart lies on it. */
function begin(canvas, x, y, title, colours, xTicks = null) {
  const { width, height } = fit(canvas);
  const context = canvas.getContext("2d");
  const toX = (value) => LEFT + ((value - x[0]) / (x[1] - x[0])) * (width - LEFT - RIGHT);
  const toY = (value) => height - BOTTOM - ((value - y[0]) / (y[1] - y[0])) * (height - BOTTOM - TOP);
  context.clearRect(0, 0, width, height);
  context.font = "11px system-ui, sans-serif";
  context.lineWidth = 1;
  context.strokeStyle = colours("line");
  context.fillStyle = colours("soft");
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const { value, text } of ticks(...y, Math.max(3, height / 40))) {
    drawLine(context, [[LEFT, toY(value)], [width - RIGHT, toY(value)]]);
    context.fillText(text, LEFT - 6, toY(value));
  }
  context.textBaseline = "bottom";
  context.textAlign = "center";
  const about = xTicks ?? Math.max(1, Math.min(4, (width - LEFT) / 45));
  for (const { value, text } of about ? ticks(...x, about) : []) {
    context.fillText(text, Math.min(toX(value), width - context.measureText(text).width / 2 - 1), height - 15);
  }
  context.fillText(title, (LEFT + width - RIGHT) / 2, height - 1);
  return { context, toX, toY, width, height };
}

/** Draw curves over time. A curve: time_s, values, colour (its name), dashed. */
export function drawCurves(canvas, duration_s, curves, least, colours, now_s = null) {
  const y = span(curves.flatMap((each) => each.values), least);
  const { context, toX, toY, height } = begin(canvas, [0, duration_s], y, "time (s)", colours);
  if (now_s !== null && now_s >= 0 && now_s <= duration_s) {
    context.strokeStyle = colours("soft");
    drawLine(context, [[toX(now_s), TOP], [toX(now_s), height - BOTTOM]]);
  }
  for (const { time_s, values, colour, dashed } of curves) {
    context.strokeStyle = colours(colour);
    context.lineWidth = dashed ? 1.2 : 1.8;
    context.setLineDash(dashed ? [5, 3] : []);
    const isKnown = (value, index) => value !== null && time_s[index] >= 0;
    drawLine(context, values.map((value, index) => isKnown(value, index) && [toX(time_s[index]), toY(value)]));
  }
  context.setLineDash([]);
}

/** Draw values in percent, one for each trial. */
export function drawLearning(canvas, percents, colours) {
  const y = [0, Math.max(...percents, 1) * 1.08];
  const x = [0.5, Math.max(percents.length, 4) + 0.5];
  const { context, toX, toY } = begin(canvas, x, y, "trial", colours, Math.min(percents.length + 1, 8));
  context.strokeStyle = context.fillStyle = colours("accent");
  context.lineWidth = 1.8;
  const points = percents.map((value, index) => [toX(index + 1), toY(value)]);
  drawLine(context, points);
  points.forEach((point) => drawDisc(context, point, 3.2));
}

/** Draw a bar for each movement; the chosen one is filled, the next best one outlined boldly. */
export function drawBars(canvas, pairs, chosen, next, colours) {
  const values = pairs.map(([, value]) => value).filter((value) => value !== null);
  const [low, high] = [Math.min(0, ...values), Math.max(0, ...values)];
  const rest = (high - low || 1) * 0.14;
  const x = [-0.5, pairs.length - 0.5];
  const { context, toX, toY } = begin(canvas, x, [low - (low < 0 ? rest : 0), high + rest], "movement", colours, 0);
  const wide = toX(1) - toX(0);
  const bar = Math.max(wide * 0.76, 1);
  context.textBaseline = "bottom";
  pairs.forEach(([name, value], index) => {
    if (value === null) return;
    const marked = name === chosen ? "accent" : name === next ? "ink" : "";
    const [left, top] = [toX(index) - bar / 2, toY(Math.max(value, 0))];
    const tall = Math.abs(toY(0) - toY(value));
    context.fillStyle = colours(name === chosen ? "accent" : "bar");
    context.fillRect(left, top, bar, tall);
    if (name === next) {
      context.strokeStyle = colours("ink");
      context.lineWidth = 2;
      context.strokeRect(left, top, bar, tall);
    }
    if (marked || wide > 22) {
      context.fillStyle = colours(marked || "soft");
      context.font = `${marked ? "700 " : ""}11px system-ui, sans-serif`;
      context.fillText(String(name), toX(index), top - 2);
    }
  });
}
