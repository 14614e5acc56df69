// What both pages share: the line to the server, its clock, and light or dark.

const ENDED = 1001; // the program that serves the pages went
const ASKED_EVERY_S = 0.5;
const REMEMBERED = 30;
const SILENT_AFTER_S = 1.5;

export function pageTime() {
  return performance.now() / 1000;
}

/** The server's clock, by the exchange of messages that took the least time lately. */
export class Clock {
  exchanges = [];
  offset_s = null;

  take({ page_s, heard_s, sent_s }) {
    const received_s = pageTime();
    const took_s = received_s - page_s - (sent_s - heard_s);
    this.exchanges.push({ took_s, offset_s: (heard_s - page_s + sent_s - received_s) / 2 });
    if (this.exchanges.length > REMEMBERED) this.exchanges.shift();
    this.offset_s = this.exchanges.reduce((best, each) => (each.took_s < best.took_s ? each : best)).offset_s;
  }

  now() {
    return pageTime() + (this.offset_s ?? 0);
  }
}

/** The line to the server; it connects again where it is cut. */
export class Line {
  clock = new Clock();
  heard_s = -Infinity;
  heard = null; // the last message's time of day
  asked_s = -Infinity;
  again_s = 0.5;
  leaving = false;
  ended = false;

  constructor(role, hear) {
    this.address = `${location.origin.replace(/^http/, "ws")}/ws/${role}${location.search}`;
    this.hear = hear;
    this.connect();
    addEventListener("pagehide", () => {
      this.leaving = true;
      this.socket.close();
    });
    addEventListener("pageshow", (event) => event.persisted && location.reload());
  }

  connect() {
    this.socket = new WebSocket(this.address);
    this.socket.onopen = () => {
      this.again_s = 0.5;
      this.ended = false;
      this.clock.exchanges = [];
      this.ask();
    };
    this.socket.onmessage = (event) => this.take(JSON.parse(event.data));
    this.socket.onclose = (event) => {
      this.heard_s = -Infinity;
      this.ended ||= event.code === ENDED; // a try to connect again ends with another code
      if (this.leaving) return;
      setTimeout(() => this.connect(), this.again_s * 1000);
      this.again_s = Math.min(this.again_s * 2, 5);
    };
  }

  take(message) {
    this.heard_s = pageTime();
    this.heard = new Date();
    if (message.kind === "clock") {
      this.clock.take(message);
      if (this.clock.exchanges.length < 5) this.ask();
    } else if (message.kind === "beat") {
      // answered, rather than sent by a timer: browsers slow the timers of a page that lies behind another window
      this.send({ kind: "alive" });
      if (this.heard_s - this.asked_s > ASKED_EVERY_S) this.ask();
    } else {
      if (message.kind === "moment") this.send({ kind: "seen" });
      this.hear(message);
    }
  }

  ask() {
    this.asked_s = pageTime();
    this.send({ kind: "clock", page_s: this.asked_s });
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** Whether nothing is heard any more, after something was. */
  get lost() {
    const silent = this.socket.readyState !== WebSocket.OPEN || pageTime() - this.heard_s > SILENT_AFTER_S;
    return this.heard !== null && silent;
  }

  /** What a page is told by `window.pamid.phase`. */
  tell(scene) {
    if (this.heard === null) return "connecting";
    return this.lost ? "lost" : scene?.phase ?? "busy";
  }
}

/** Follow the system's choice of light or dark until the key d is pressed; `changed` is called with the colours. */
export function followTheme(changed) {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const set = (theme) => {
    document.documentElement.dataset.theme = theme;
    const style = getComputedStyle(document.documentElement);
    changed((name) => style.getPropertyValue(`--${name}`).trim());
  };
  set(dark.matches ? "dark" : "light");
  dark.addEventListener("change", () => set(dark.matches ? "dark" : "light"));
  return () => set(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
}

/** Return whether a trial is about to begin or runs. */
export function isMoving(scene) {
  return ["countdown", "running"].includes(scene?.phase);
}

export function find(id) {
  return document.getElementById(id);
}

/** Set text only where it differs, so that a page that is read aloud is not read again. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function make(name, text = "", className = "") {
  const element = document.createElement(name);
  element.textContent = text;
  element.className = className;
  return element;
}

/** Give a canvas as many pixels as the screen shows of it, and return its size in CSS pixels. */
export function fit(canvas) {
  const ratio = devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  const [across, down] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== across || canvas.height !== down) Object.assign(canvas, { width: across, height: down });
  canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
  return { width, height };
}

/** Draw a line through points; it has a gap where one is null. */
export function drawLine(context, points) {
  context.beginPath();
  points.forEach((point, index) => point && context[index && points[index - 1] ? "lineTo" : "moveTo"](...point));
  context.stroke();
}

/** Draw a disc, or the circle around it. */
export function drawDisc(context, [x, y], radius, filled = true) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context[filled ? "fill" : "stroke"]();
}

/** Return the row of a table at a time, on the line between its neighbours. */
export function interpolate(time_s, rows, at_s) {
  const last = time_s.length - 1;
  if (at_s <= time_s[0]) return rows[0];
  if (at_s >= time_s[last]) return rows[last];
  const spacing_s = time_s[1] - time_s[0];
  const left = Math.min(Math.floor((at_s - time_s[0]) / spacing_s), last - 1);
  const share = (at_s - time_s[left]) / spacing_s;
  return rows[left].map((value, column) => value + share * (rows[left + 1][column] - value));
}

export function degrees(angle_rad) {
  return (angle_rad * 180) / Math.PI;
}
