import { drawBars, drawCurves, drawLearning } from "./charts.js";
import { degrees, find, followTheme, isMoving, Line, make, pageTime, write } from "./shared.js";

const DRAWN_EVERY_S = 1 / 15;
const KEYS = { accept: "a", skip: "s", keep: "k", repeat: "r", reject: "x", pause: "q" };
const NAMES = { pause: "stop for today" };
const PHASES = {
  busy: "preparing",
  proposed: "a trial is proposed",
  countdown: "countdown",
  running: "running",
  judging: "keep this trial?",
  over: "the study is over for now",
};
const KINDS = [
  { title: "angle (°)", of: "angle_rad", least: 5 },
  { title: "pressure (kPa)", of: "pressure_kpa", least: 20 },
  { title: "force (N)", of: "force_n", least: 10 },
];

let scene = null;
let colours = () => "";
let samples = [];
let panels = [];
let decided = null;
let dirty = true;
let drawn_s = 0;
window.pamid = { frames: 0, phase: "connecting" };

const line = new Line("operator", (message) => {
  if (message.kind === "moment") {
    // times start again where another trial begins
    if (samples.length && message.time_s < samples.at(-1).time_s) samples = [];
    samples.push(message);
  } else if (message.kind === "scene") {
    takeScene(message);
  } else if (message.kind === "refused") {
    decided = null;
    warn("refused", message.why);
    showChoices();
  }
  dirty = true;
});

function takeScene(next) {
  if (decided !== null && (next.question !== scene.question || !next.choices.length)) {
    // what was written since is for the next decision
    if (find("note").value === decided.note) find("note").value = "";
    decided = null;
  }
  if (["proposed", "countdown"].includes(next.phase)) samples = [];
  const sameMachine = JSON.stringify(scene?.machine) === JSON.stringify(next.machine);
  scene = next;
  if (!sameMachine) makePanels();
  show();
}

// what goes to the server

function decide(word) {
  if (scene === null || line.lost || decided !== null || !scene.choices.includes(word)) return;
  decided = { word, note: find("note").value };
  warn("refused", "");
  line.send({ kind: "decide", ...decided, question: scene.question });
  showChoices();
}

function stop() {
  if (isMoving(scene)) line.send({ kind: "stop", why: "the operator pressed stop" });
}

// what is shown

function warn(id, text) {
  write(find(id), text);
  find(id).hidden = !text;
}

function show() {
  const { outcome, phase } = scene;
  const trial = phase === "busy" ? null : scene.trial;
  write(find("label"), trial ? trial.title : "no trial runs");
  const facts = trial ? [`${trial.duration_s.toFixed(1)} s`] : [];
  if (trial && trial.trajectory !== null) facts.push(`movement ${trial.trajectory}`);
  if (trial) facts.push("in the log: ");
  write(find("facts"), facts.join(" · "));
  write(find("logged"), trial?.label ?? "");
  write(find("reason"), trial?.reason ?? "");
  const off = outcome.tracking_error_rad ?? [];
  const told = off.map((each, index) => `${scene.machine.joints[index].name} ${degrees(each).toFixed(1)}°`);
  write(find("result"), phase === "judging" && told.length ? `Tracking error (root mean square): ${told.join(", ")}` : "");
  const stopping = isMoving(scene) && scene.stop ? `stopping: ${scene.stop}` : "";
  warn("problem", stopping || outcome.problem || outcome.stopped || "");
  if (decided === null && !["proposed", "judging"].includes(phase)) warn("refused", "");
  find("automatic").checked = scene.automatic;
  const pages = Object.entries(scene.pages).map(([role, count]) => {
    return `${role} ${count || "none"}${!count && scene.needed.includes(role) ? ", but needed" : ""}`;
  });
  write(find("pages"), pages.join(" · "));
  find("address").href = scene.participant_url;
  write(find("address"), scene.participant_url);
  const { position = null, total } = scene.trial ?? {};
  write(find("progress"), position === null || trial === null ? "" : `trial ${position} of ${total}`);
  find("done").style.width = position === null ? "0" : `${(100 * (position - 1)) / Math.max(total, 1)}%`;
  showChoices();
  showHistory();
  showFigures();
  showState();
}

function showState() {
  const lost = line.lost;
  const left = scene?.starts_at_s == null ? null : scene.starts_at_s - line.clock.now();
  let told = scene === null ? "connecting" : PHASES[scene.phase];
  if (scene?.phase === "judging" && !scene.choices.includes("keep")) {
    told = scene.outcome.stopped ? "stopped, what next?" : "the result";
  }
  if (line.ended) told = "ended: the terminal says how";
  else if (lost) told = "connection lost";
  else if (scene?.phase === "countdown" && left > 0) told = `begins in ${Math.ceil(left)}`;
  else if (scene?.phase === "running") told = left > 0 ? "filling the muscles" : `running, ${Math.min(-left, scene.trial.duration_s).toFixed(1)} s`;
  write(find("phase"), told);
  find("phase").classList.toggle("bad", lost);
  document.body.classList.toggle("stale", lost);
  if (lost) write(find("heard"), line.heard.toLocaleTimeString());
  find("lost").hidden = !lost || line.ended;
  find("choices").inert = find("automatic").disabled = lost;
  find("stop").disabled = lost || !isMoving(scene) || Boolean(scene.stop);
  window.pamid.phase = line.tell(scene);
}

function showChoices() {
  const area = find("choices");
  const shown = JSON.stringify([scene.phase, scene.choices, decided, scene.question]);
  if (area.dataset.shown === shown) return;
  area.dataset.shown = shown;
  area.replaceChildren(
    ...(["proposed", "judging"].includes(scene.phase) ? scene.choices : []).map((word) => {
      const button = make("button", NAMES[word] ?? word, word);
      button.type = "button";
      button.dataset.word = word;
      button.disabled = decided !== null;
      button.append(" ", make("kbd", KEYS[word] ?? ""));
      button.addEventListener("click", () => decide(word));
      return button;
    }),
  );
}

function showHistory() {
  find("history").hidden = scene.history.length === 0;
  const body = find("history").querySelector("tbody");
  if (body.rows.length === scene.history.length) return;
  body.replaceChildren(
    ...[...scene.history].reverse().map(({ trial, decision, note }) => {
      const row = make("tr");
      row.append(make("td", trial), make("td", NAMES[decision] ?? decision), make("td", note));
      return row;
    }),
  );
}

function showFigures() {
  const errors = (scene.trial?.errors ?? []).filter((each) => each !== null);
  find("learning").hidden = errors.length === 0;
  if (errors.length) {
    drawLearning(find("learning").querySelector("canvas"), errors.map((each) => 100 * each), colours);
    const told = `${errors.length} trial${errors.length === 1 ? "" : "s"}, now ${(100 * errors.at(-1)).toFixed(1)} %`;
    write(find("learning").querySelector("p"), told);
  }
  const utilities = scene.phase === "busy" ? [] : scene.trial?.utilities ?? [];
  find("utilities").hidden = utilities.length === 0;
  if (!utilities.length) return;
  const { trajectory: chosen, utility_unit: unit } = scene.trial;
  write(find("utilities").querySelector("h2"), `Utility of each movement of the bank${unit && ` (${unit})`}`);
  const canSkip = scene.choices.includes("skip");
  const others = utilities.filter(([name, value]) => canSkip && name !== chosen && value !== null);
  const next = others.length ? others.reduce((best, each) => (each[1] > best[1] ? each : best)) : null;
  drawBars(find("utilities").querySelector("canvas"), utilities, chosen, next?.[0], colours);
  const own = utilities.find(([name]) => name === chosen)?.[1];
  const told = own == null ? [] : [`proposed: movement ${chosen} (${own.toPrecision(3)})`];
  if (next) told.push(`skipping it chooses movement ${next[0]} (${next[1].toPrecision(3)}), outlined`);
  write(find("utilities").querySelector("p"), told.join("; "));
}

// strip charts: one column for each joint

function makePanels() {
  const joints = scene.machine.joints ?? [];
  panels = joints.flatMap((joint, column) =>
    KINDS.map((kind) => {
      const figure = make("figure");
      const canvas = make("canvas");
      const title = `${joint.name} ${kind.title}`;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${title} over time`);
      figure.append(make("figcaption", title), canvas);
      const muscles = scene.machine.muscles.map((each, index) => ({ ...each, index }));
      return { ...kind, column, muscles: muscles.filter((each) => each.joint === joint.name), figure, canvas };
    }),
  );
  const area = find("charts");
  area.style.setProperty("--joints", Math.max(joints.length, 1));
  area.replaceChildren(
    ...KINDS.flatMap((kind) => panels.filter((each) => each.of === kind.of)).map((each) => each.figure),
  );
}

function gather() {
  const { outcome, trial, phase } = scene;
  if (phase === "judging" && outcome.time_s) {
    const { time_s, joint_angle_rad, pressure_command_kpa, pressure_kpa, force_n } = outcome;
    return { time_s, angle_rad: joint_angle_rad, pressure_kpa, force_n, command_s: time_s, command_kpa: pressure_command_kpa };
  }
  const of = (name) => [name, samples.map((each) => each[name])];
  const measured = Object.fromEntries(["time_s", "angle_rad", "pressure_kpa", "force_n"].map(of));
  return { ...measured, command_s: trial?.time_s ?? [], command_kpa: trial?.pressure_command_kpa ?? [] };
}

function drawPanels() {
  const data = gather();
  const { trial } = scene;
  const now_s = scene.phase === "running" ? data.time_s.at(-1) ?? null : null;
  for (const { of, column, muscles, canvas, least } of panels) {
    const isAngle = of === "angle_rad";
    const curves = [];
    const add = (time_s, rows, index, colour, dashed) => {
      curves.push({ time_s, values: rows.map((row) => (isAngle ? degrees(row[index]) : row[index])), colour, dashed });
    };
    if (isAngle && trial?.reference_rad) add(trial.time_s, trial.reference_rad, column, "target", true);
    if (isAngle) add(data.time_s, data.angle_rad, column, "you", false);
    for (const { index, role } of isAngle ? [] : muscles) {
      if (of === "pressure_kpa") add(data.command_s, data.command_kpa, index, role, true);
      add(data.time_s, data[of], index, role, false);
    }
    drawCurves(canvas, trial?.duration_s ?? 1, curves, least, colours, now_s);
  }
}

function turn() {
  const now_s = pageTime();
  if (scene !== null && dirty && now_s - drawn_s >= DRAWN_EVERY_S) {
    dirty = false;
    drawn_s = now_s;
    drawPanels();
    window.pamid.frames += 1;
  }
  showState();
  requestAnimationFrame(turn);
}

function redraw() {
  dirty = true;
  if (scene !== null) showFigures();
}

const toggleTheme = followTheme((named) => {
  colours = named;
  redraw();
});
addEventListener("resize", redraw);
find("stop").addEventListener("click", stop);
find("automatic").addEventListener("change", (event) => line.send({ kind: "automatic", on: event.target.checked }));
addEventListener("keydown", (event) => {
  const typing = event.target === find("note");
  if ((event.key === " " && !typing) || event.key === "Escape") {
    // while nothing moves, the space bar presses the button that is chosen, as everywhere
    if (!isMoving(scene)) return;
    event.preventDefault();
    stop();
  } else if (typing || event.ctrlKey || event.metaKey || event.altKey || event.repeat) {
    return;
  } else if (event.key === "d") {
    toggleTheme();
  } else {
    const word = Object.keys(KEYS).find((each) => KEYS[each] === event.key.toLowerCase());
    if (word) decide(word);
  }
});
requestAnimationFrame(turn);
