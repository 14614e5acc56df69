import { chain, drawArm, drawBody, findBox, placeBox, reach } from "./arm.js";
import { degrees, drawDisc, find, fit, followTheme, interpolate } from "./shared.js";
import { isMoving, Line, make, pageTime, write } from "./shared.js";

const GHOSTS_S = [1, 0.75, 0.5, 0.25];
const REPORTED_EVERY_S = 0.2;
const POINTED_EVERY_S = 1 / 60;
const RING = 2 * Math.PI * 52;
const WORDS = [[3, "very close"], [6, "close"], [12, "not far off"], [Infinity, "far off: take your time to follow"]];

const canvas = find("arms");
const context = canvas.getContext("2d", { alpha: false });
let scene = { phase: "busy", machine: {}, trial: null, outcome: {} };
let moment = null;
let box = null;
let colours = () => "";
let dirty = true;
let drawn = [];
let reported_s = 0;
let pointed = null;
let pointed_s = 0;
let posture = null;
let leavingFull = false;
window.pamid = { frames: 0, phase: "connecting" };

const line = new Line("participant", (message) => {
  if (message.kind === "moment") moment = message;
  else if (message.kind === "scene") takeScene(message);
  dirty = true;
});

function takeScene(next) {
  const another = next.phase === "proposed" || next.starts_at_s !== scene.starts_at_s;
  if (another) report();
  // a posture of the trial before is none of this one, which may begin without a countdown
  if (another || next.phase === "countdown") moment = null;
  if (next.phase === "proposed") posture = null;
  scene = next;
  const joints = scene.machine.joints ?? [];
  box = joints.length ? findBox(joints) : null;
  tell();
}

function isRunning() {
  return scene.phase === "running" && scene.starts_at_s !== null;
}

function trialTime() {
  return line.clock.now() - scene.starts_at_s;
}

function stop(why) {
  if (isMoving(scene)) line.send({ kind: "stop", why });
}

// words

function say() {
  const { phase, trial, outcome } = scene;
  const tracked = Boolean(trial?.reference_rad);
  if (line.heard === null) return ["Please wait", "connecting"];
  if (line.ended) return ["The program has ended", "thank you; the operator says how it goes on"];
  if (line.lost) return ["Connection lost", "this page shows and stops nothing now: tell the operator"];
  if (scene.stop && isMoving(scene)) return ["Stopped", "stay relaxed"];
  if (phase === "proposed") return ["The next movement begins soon", outcome.stopped ? "the last one did not begin" : ""];
  if (phase === "countdown") return ["Get ready", tracked ? "the red arm shows where it begins" : ""];
  if (phase === "running") {
    if (trial?.kind === "passive") return ["Do not move", "the robot moves by itself"];
    if (trialTime() < 0) return ["Get ready", "the robot fills its muscles"];
    return tracked ? ["Follow the red arm", "the pale ones show what comes next"] : ["Move freely", ""];
  }
  if (phase === "judging") {
    if (outcome.stopped) return ["Stopped", "please wait"];
    const off = outcome.tracking_error_rad;
    if (!off?.length) return ["Done", "thank you, please wait"];
    const mean = degrees(Math.sqrt(off.reduce((sum, each) => sum + each * each, 0) / off.length));
    return ["Done", `you were ${WORDS.find(([most]) => mean < most)[1]}`];
  }
  if (phase === "over") {
    return outcome.problem ? ["Stopped", "the movement was ended; please wait"] : ["That is all", "thank you"];
  }
  return ["Please wait", "preparing"];
}

function tell() {
  const [told, more] = say();
  write(find("told"), told);
  write(find("more"), more);
  const off = scene.phase === "judging" && !line.lost ? scene.outcome.tracking_error_rad ?? [] : [];
  const shown = off.map((each, index) => [scene.machine.joints[index].name, `${degrees(each).toFixed(1)}°`]);
  const list = find("errors");
  if (list.dataset.shown !== String(shown)) {
    list.dataset.shown = String(shown);
    list.replaceChildren(...shown.flatMap(([name, error]) => [make("dt", name), make("dd", error)]));
  }
  find("legend").classList.toggle("shown", isShowing());
  find("stop").disabled = line.lost || !isMoving(scene) || Boolean(scene.stop);
  const phase = line.tell(scene);
  dirty ||= phase !== window.pamid.phase;
  window.pamid.phase = phase;
}

function count() {
  const left = scene.starts_at_s === null ? null : scene.starts_at_s - line.clock.now();
  const silent = line.lost || left === null || scene.stop;
  let [text, share] = ["", 0];
  if (!silent && scene.phase === "countdown" && left > 0) {
    text = String(Math.ceil(left));
    share = left - Math.floor(left);
  } else if (!silent && scene.phase === "running" && left <= 0) {
    share = Math.min(-left / scene.trial.duration_s, 1);
    text = String(Math.ceil(Math.max(scene.trial.duration_s + left, 0)));
  }
  write(find("count"), text);
  find("count").classList.toggle("long", text.length > 2);
  find("progress").style.strokeDasharray = `${share * RING} ${RING}`;
  document.body.classList.toggle("counting", text !== "");
}

// the picture

function isShowing() {
  return !line.lost && isMoving(scene) && Boolean(scene.trial?.reference_rad);
}

function draw() {
  const { width, height } = fit(canvas);
  context.fillStyle = colours("paper");
  context.fillRect(0, 0, width, height);
  if (box === null) return;
  const place = placeBox(box, width, height);
  const size = Math.min(width, height) / 26;
  drawBody(context, place, colours("body"));
  let shown_reference_s = null;
  let keepOff = [];
  const at_s = isRunning() ? trialTime() : 0;
  if (isShowing() && !scene.stop) {
    const { time_s, reference_rad } = scene.trial;
    for (const ahead_s of GHOSTS_S) {
      const look = { colour: colours("target"), width: 0.022, alpha: 0.07 + 0.27 * (1.1 - ahead_s) };
      drawArm(context, place, interpolate(time_s, reference_rad, at_s + ahead_s), look);
    }
    const reference = interpolate(time_s, reference_rad, at_s);
    const look = { colour: colours("target"), width: 0.062, dashed: true, label: "target", side: 1, size };
    keepOff = drawArm(context, place, reference, look);
    shown_reference_s = at_s;
  }
  if (moment !== null && !line.lost) {
    const look = { colour: colours("you"), width: 0.034, label: "you", side: -1, size, keepOff };
    drawArm(context, place, moment.angle_rad, look);
  }
  drawPointer(place);
  if (isRunning() && !line.lost && line.clock.offset_s !== null) {
    drawn.push([line.clock.now(), shown_reference_s, moment?.time_s ?? null]);
  }
}

function report() {
  reported_s = pageTime();
  if (drawn.length) line.send({ kind: "drawn", starts_at_s: scene.starts_at_s, frames: drawn.splice(0) });
}

// a posture that the pointer asks for, where the machine says so

function drawPointer(place) {
  if (pointed === null || !scene.machine.pointer) return;
  const joints = scene.machine.joints;
  if (posture?.length !== joints.length) posture = joints.map((each) => (each.lower_rad + each.upper_rad) / 2);
  const target = [(pointed.x - place.x) / place.scale, (pointed.y - place.y) / place.scale];
  posture = reach(target, posture, joints);
  const tip = chain(posture).at(-1);
  context.strokeStyle = colours("ink");
  context.lineWidth = 2;
  drawDisc(context, [pointed.x, pointed.y], 9, false);
  drawDisc(context, [place.x + place.scale * tip[0], place.y + place.scale * tip[1]], 3, false);
  if (pageTime() - pointed_s >= POINTED_EVERY_S - 0.002) {
    pointed_s = pageTime();
    line.send({ kind: "pointer", angle_rad: posture });
  }
}

canvas.addEventListener("pointermove", (event) => {
  if (!scene.machine.pointer) return;
  const area = canvas.getBoundingClientRect();
  pointed = { x: event.clientX - area.left, y: event.clientY - area.top };
  dirty = true;
});

// the turn of each frame

function turn() {
  const now_s = pageTime();
  if (isMoving(scene) || dirty || pointed !== null) {
    dirty = false;
    draw();
    window.pamid.frames += 1;
  }
  tell();
  count();
  if (now_s - reported_s > REPORTED_EVERY_S) report();
  requestAnimationFrame(turn);
}

const toggleTheme = followTheme((named) => {
  colours = named;
  dirty = true;
});
new ResizeObserver(() => (dirty = true)).observe(canvas);
addEventListener("visibilitychange", () => document.hidden && stop("the participant's page is hidden"));
find("stop").addEventListener("click", () => stop("the participant pressed stop"));
addEventListener("keydown", (event) => {
  if (event.key === " " || event.key === "Escape") {
    event.preventDefault();
    stop("the participant pressed stop");
  } else if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) {
    return;
  } else if (event.key === "d") {
    toggleTheme();
  } else if (event.key === "f") {
    leavingFull = Boolean(document.fullscreenElement);
    if (leavingFull) document.exitFullscreen();
    else document.documentElement.requestFullscreen();
  }
});
// browsers take Esc for themselves where a page fills the screen
addEventListener("fullscreenchange", () => {
  if (!document.fullscreenElement && !leavingFull) stop("the participant pressed stop");
  leavingFull = false;
});
requestAnimationFrame(turn);
