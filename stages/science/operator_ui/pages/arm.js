// An arm as a chain of links, seen from the side: how it is drawn, and which posture reaches a point.
// The first joint's angle is taken from straight down, each further one from the link before; forward is to the right.

import { drawDisc, drawLine } from "./shared.js";

const SHRINK = 0.86;
const POSTURES = 1500;
const TURNS = 60;
const STARTS = [0.5, 0.2, 0.8];
const NEAR = 0.01; // of the arm's length
const MARGIN = 0.09; // of the area

/** Return the joints and the tip as points, for an arm of length 1 whose shoulder is at the origin. */
export function chain(angle_rad) {
  const points = [[0, 0]];
  const total = angle_rad.reduce((sum, _, index) => sum + SHRINK ** index, 0);
  let direction = 0;
  angle_rad.forEach((angle, index) => {
    direction += angle;
    const [x, y] = points[index];
    const length = SHRINK ** index / total;
    points.push([x + length * Math.sin(direction), y + length * Math.cos(direction)]);
  });
  return points;
}

/** Return the box that holds the arm in all postures between its joints' limits, and a head above the shoulder. */
export function findBox(joints) {
  const each = Math.max(2, Math.floor(POSTURES ** (1 / joints.length)));
  const box = { left: -0.2, right: 0.2, top: -0.42, bottom: 0.7 };
  for (let number = 0; number < Math.min(each ** joints.length, POSTURES); number += 1) {
    let rest = number;
    const posture = joints.map(({ lower_rad, upper_rad }) => {
      const share = (rest % each) / (each - 1);
      rest = Math.floor(rest / each);
      return lower_rad + share * (upper_rad - lower_rad);
    });
    for (const [x, y] of chain(posture)) {
      box.left = Math.min(box.left, x);
      box.right = Math.max(box.right, x);
      box.top = Math.min(box.top, y);
      box.bottom = Math.max(box.bottom, y);
    }
  }
  return box;
}

/** Return where the shoulder lies and how long the arm is, in pixels, so that the box fills an area. */
export function placeBox(box, width, height) {
  const { left, right, top, bottom } = box;
  const scale = (1 - 2 * MARGIN) * Math.min(width / (right - left), height / (bottom - top));
  return { scale, x: (width - scale * (left + right)) / 2, y: (height - scale * (top + bottom)) / 2 };
}

/**
 * Return a posture within the limits whose tip is near a point: from the one before, so that the arm does not jump, else,
 * where a limit is in the way, from the best of a few others.
 */
export function reach(target, from_rad, joints) {
  const miss = (posture) => {
    const [x, y] = chain(posture).at(-1);
    return Math.hypot(x - target[0], y - target[1]);
  };
  const near = approach(target, from_rad, joints);
  if (miss(near) < NEAR) return near;
  const others = STARTS.map((share) =>
    approach(target, joints.map(({ lower_rad, upper_rad }) => lower_rad + share * (upper_rad - lower_rad)), joints),
  );
  return others.reduce((best, each) => (miss(each) < miss(best) - NEAR ? each : best), near);
}

/** Return where a posture gets when each joint in turn points the tip at a point. */
function approach(target, from_rad, joints) {
  const posture = [...from_rad];
  const clip = (value, { lower_rad, upper_rad }) => Math.min(Math.max(value, lower_rad), upper_rad);
  for (let turn = 0; turn < TURNS; turn += 1) {
    for (let joint = posture.length - 1; joint >= 0; joint -= 1) {
      const points = chain(posture);
      const [[x, y], [tipX, tipY]] = [points[joint], points.at(-1)];
      const off = Math.atan2(target[0] - x, target[1] - y) - Math.atan2(tipX - x, tipY - y);
      posture[joint] = clip(posture[joint] + Math.atan2(Math.sin(off), Math.cos(off)), joints[joint]);
    }
  }
  return posture;
}

export function drawBody(context, place, colour) {
  const { x, y, scale } = place;
  context.save();
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = 0.13 * scale;
  context.lineCap = "round";
  drawLine(context, [[x, y + 0.02 * scale], [x, y + 0.62 * scale]]);
  drawDisc(context, [x, y - 0.25 * scale], 0.13 * scale);
  context.restore();
}

/**
 * Draw an arm and return where its tip and its label are.
 * `look`: colour, width (of the arm's length), alpha, dashed, label, side of the tip (1 or -1) and size of the label,
 * and points near which the label fades, as two labels over each other cannot be read.
 */
export function drawArm(context, place, angle_rad, look) {
  const points = chain(angle_rad).map(([x, y]) => [place.x + place.scale * x, place.y + place.scale * y]);
  const width = look.width * place.scale;
  context.save();
  context.globalAlpha = look.alpha ?? 1;
  context.strokeStyle = context.fillStyle = look.colour;
  context.lineWidth = width;
  context.lineJoin = "round";
  context.lineCap = look.dashed ? "butt" : "round";
  if (look.dashed) context.setLineDash([2.1 * width, 0.9 * width]);
  drawLine(context, points);
  context.setLineDash([]);
  const marks = look.label ? drawTip(context, points, width, look) : [];
  context.restore();
  return marks;
}

function drawTip(context, points, width, look) {
  points.slice(0, -1).forEach((point) => drawDisc(context, point, 0.75 * width));
  const [[fromX, fromY], [x, y]] = points.slice(-2);
  const length = Math.hypot(x - fromX, y - fromY) || 1;
  const [alongX, alongY] = [(x - fromX) / length, (y - fromY) / length];
  context.lineWidth = 0.45 * width;
  drawDisc(context, [x, y], (look.dashed ? 1.35 : 0.9) * width, !look.dashed);
  const size = Math.max(15, look.size);
  context.font = `600 ${size}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  const half = context.measureText(look.label).width / 2;
  const away = 2 * width + half * Math.abs(alongY) + (size / 2) * Math.abs(alongX) + 4;
  const label = [x + look.side * alongY * away, y - look.side * alongX * away];
  const near = Math.min(...(look.keepOff ?? []).map((mark) => Math.hypot(mark[0] - label[0], mark[1] - label[1])));
  context.globalAlpha = Math.min(Math.max((near - 2.2 * size) / size, 0), 1);
  context.fillText(look.label, ...label);
  return [[x, y], label];
}
