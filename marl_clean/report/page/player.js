"use strict";
// Plays recordings (replay.json): the house or a robot's map, contacts, and who says what.
// All state of a player is its step and the matrix it shows; any step is drawn from the last
// snapshot before it, so that scrubbing backwards costs as little as forwards.

const HOUSE = ["wall", "furniture", "dirty", "clean", "spilt"];
const MAP = ["unknown", "blocked"]; // from 2 on: available, the cleaner the higher
const AVAILABLE = 2, LEVELS = 5;
const EVERY = 32; // steps between snapshots
const ROBOTS = [
  "#0072b2", "#d55e00", "#008c66", "#b24c84", "#b08000", "#2e86c1", "#784212", "#3c3c3c",
];
const COLOURS = {
  wall: "#3a424e", furniture: "#96765c", dirty: "#decba4", clean: "#a8ded1", spilt: "#c9a227",
  unknown: "#9ea3ab", blocked: "#111317", contact: "#7030be",
};

class Matrix {
  // One matrix of codes at any step, from its first codes and the changes of each step.
  constructor(first, changes) {
    this.changes = changes;
    this.snapshots = [Uint8Array.from(first, Number)];
    const codes = this.snapshots[0].slice();
    changes.forEach((changed, index) => {
      apply(codes, changed);
      if ((index + 1) % EVERY === 0) this.snapshots.push(codes.slice());
    });
  }

  at(step) {
    const from = Math.floor(step / EVERY);
    const codes = this.snapshots[from].slice();
    for (let index = from * EVERY; index < step; index++) apply(codes, this.changes[index]);
    return codes;
  }
}

function apply(codes, changed) {
  for (let index = 0; index < changed.length; index += 2) codes[changed[index]] = changed[index + 1];
}

class Episode {
  constructor(recording) {
    Object.assign(this, recording);
    this.steps = recording.contacts.length;
    this.matrices = [new Matrix(recording.house, recording.house_changes)];
    recording.maps.forEach((first, map) => {
      const changes = recording.map_changes.map((maps) => maps[map]);
      this.matrices.push(new Matrix(first, changes));
    });
    this.bytes = recording.messages
      ? Uint8Array.from(atob(recording.messages), (letter) => letter.charCodeAt(0))
      : null;
  }

  // What can be shown: the house, and the shared map or each robot's.
  views() {
    const names = this.maps.length === 1 ? ["shared map"] : this.maps.map((_, i) => `map of robot ${i + 1}`);
    return ["house", ...names];
  }

  place(step, robot) {
    return [this.positions[step][2 * robot], this.positions[step][2 * robot + 1]];
  }

  // The numbers that a robot sends in a step, from -1 to 1; null where nothing is sent.
  message(step, robot) {
    if (!this.bytes || step >= this.steps) return null;
    const first = (step * this.n_agents + robot) * this.message_numbers;
    return Array.from(this.bytes.slice(first, first + this.message_numbers), (b) => (b - 128) / 127);
  }

  // Pairs of robots in contact when the actions of a step are chosen.
  contactsAt(step) {
    const ends = step < this.steps ? this.contacts[step] : [];
    return Array.from({ length: ends.length / 2 }, (_, i) => [ends[2 * i], ends[2 * i + 1]]);
  }

  // Free cells cleaned a step, over the last ten steps.
  speed(step) {
    const from = Math.max(0, step - 10);
    const free = [...this.house].filter((code) => Number(code) >= 2).length;
    return step === from ? 0 : ((this.coverage[step] - this.coverage[from]) * free) / (step - from);
  }

  describe(step) {
    const pairs = this.contactsAt(step).map(([i, j]) => `${i + 1} and ${j + 1}`);
    const bits = this.bits && step < this.steps ? `; ${this.bits[step].reduce((a, b) => a + b, 0)} bits` : "";
    const speed = this.speed(step).toFixed(1);
    const contact = pairs.length ? pairs.join(", ") : "none";
    return `step ${step} of ${this.steps}: ${(100 * this.coverage[step]).toFixed(1)} % clean, ${speed} cells a step; in contact: ${contact}${bits}`;
  }
}

function colourOf(view, code) {
  if (view === 0) return COLOURS[HOUSE[code]];
  if (code < AVAILABLE) return COLOURS[MAP[code]];
  return mixed(COLOURS.dirty, COLOURS.clean, (code - AVAILABLE) / LEVELS);
}

function mixed(from, to, share) {
  const parts = [1, 3, 5].map((at) => {
    const ends = [from, to].map((colour) => parseInt(colour.slice(at, at + 2), 16));
    return Math.round(ends[0] + share * (ends[1] - ends[0]));
  });
  return `rgb(${parts.join(",")})`;
}

// Blue for negative numbers, orange for positive, by their size.
function messageColour(number) {
  return mixed("#f4f4f4", number < 0 ? "#0072b2" : "#d55e00", Math.min(1, Math.abs(number)));
}

function drawEpisode(canvas, episode, view, step) {
  const scale = window.devicePixelRatio || 1;
  const side = Math.max(2, Math.floor((canvas.parentElement.clientWidth * scale) / episode.cols));
  const cell = Math.min(side, Math.floor(26 * scale));
  canvas.width = cell * episode.cols;
  canvas.height = cell * episode.rows;
  canvas.style.width = `${canvas.width / scale}px`;
  const pen = canvas.getContext("2d");
  const codes = episode.matrices[view].at(step);
  codes.forEach((code, index) => {
    pen.fillStyle = colourOf(view, code);
    const row = Math.floor(index / episode.cols), col = index % episode.cols;
    pen.fillRect(col * cell, row * cell, cell - (cell > 6 ? 1 : 0), cell - (cell > 6 ? 1 : 0));
  });
  const centre = (robot) => episode.place(step, robot).map((at) => (at + 0.5) * cell);
  pen.strokeStyle = COLOURS.contact;
  pen.lineWidth = Math.max(2, cell / 9);
  for (const [first, second] of episode.contactsAt(step)) {
    const [from, to] = [centre(first), centre(second)];
    pen.beginPath();
    pen.moveTo(from[1], from[0]);
    pen.lineTo(to[1], to[0]);
    pen.stroke();
  }
  for (let robot = 0; robot < episode.n_agents; robot++) {
    const [row, col] = centre(robot);
    pen.beginPath();
    pen.arc(col, row, Math.max(cell * 0.42, 6 * scale), 0, 2 * Math.PI);
    pen.fillStyle = ROBOTS[robot % ROBOTS.length];
    pen.fill();
    pen.strokeStyle = "#ffffff";
    pen.lineWidth = Math.max(1, cell / 16);
    pen.stroke();
    pen.fillStyle = "#ffffff";
    pen.font = `${Math.max(cell * 0.5, 9 * scale)}px sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(String(robot + 1), col, row);
  }
}

function drawMessages(canvas, episode, step) {
  const numbers = episode.message_numbers || 0;
  canvas.hidden = !numbers;
  if (!numbers) return;
  const cell = 7, height = 14;
  canvas.width = numbers * cell + 20;
  canvas.height = episode.n_agents * height;
  const pen = canvas.getContext("2d");
  for (let robot = 0; robot < episode.n_agents; robot++) {
    pen.fillStyle = ROBOTS[robot % ROBOTS.length];
    pen.fillRect(0, robot * height, 14, height - 2);
    const message = episode.message(step, robot) || [];
    message.forEach((number, index) => {
      pen.fillStyle = messageColour(number);
      pen.fillRect(20 + index * cell, robot * height, cell - 1, height - 2);
    });
  }
}

class Player {
  // Two episodes side by side, or one; one slider for both.
  constructor(root, recordings) {
    this.root = root;
    this.recordings = recordings;
    this.episodes = new Map();
    this.step = 0;
    this.timer = null;
    this.slider = root.querySelector("input[type=range]");
    this.status = root.querySelector("[role=status]");
    this.playButton = root.querySelector("button.play");
    this.panels = [...root.querySelectorAll(".panel")].map((panel) => ({
      panel,
      policy: panel.querySelector("select.policy"),
      view: panel.querySelector("select.view"),
      house: panel.querySelector("canvas.house"),
      messages: panel.querySelector("canvas.messages"),
      text: panel.querySelector(".described"),
    }));
    for (const side of this.panels) {
      side.policy.addEventListener("change", () => this.choose(side));
      side.view.addEventListener("change", () => this.draw());
    }
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
    this.playButton.addEventListener("click", () => this.toggle());
    root.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("resize", () => this.draw());
    window.addEventListener("hashchange", () => this.follow());
    this.panels.forEach((side, index) => {
      side.policy.value = String(Math.min(index, recordings.length - 1));
      this.choose(side, false);
    });
    this.follow();
    this.draw();
  }

  episode(side) {
    const index = side.policy.value;
    if (index === "") return null;
    if (!this.episodes.has(index)) this.episodes.set(index, new Episode(this.recordings[index]));
    return this.episodes.get(index);
  }

  choose(side, redraw = true) {
    const episode = this.episode(side);
    const shown = side.view.selectedIndex;
    side.view.replaceChildren();
    for (const [index, name] of (episode ? episode.views() : []).entries()) {
      side.view.append(new Option(name, String(index)));
    }
    side.view.selectedIndex = Math.max(0, Math.min(shown, side.view.options.length - 1));
    const longest = this.panels.map((each) => this.episode(each)).map((each) => (each ? each.steps : 0));
    this.slider.max = String(Math.max(...longest));
    if (redraw) this.go(Math.min(this.step, Number(this.slider.max)));
  }

  go(step) {
    this.step = Math.max(0, Math.min(step, Number(this.slider.max)));
    this.draw();
  }

  draw() {
    this.slider.value = String(this.step);
    const texts = [];
    for (const side of this.panels) {
      const episode = this.episode(side);
      side.panel.classList.toggle("empty", !episode);
      if (!episode) continue;
      const step = Math.min(this.step, episode.steps);
      drawEpisode(side.house, episode, Number(side.view.value), step);
      drawMessages(side.messages, episode, step);
      side.text.textContent = episode.describe(step);
      side.house.setAttribute("aria-label", this.spoken(episode, step));
      texts.push(`${episode.policy}: ${episode.describe(step)}`);
    }
    this.slider.setAttribute("aria-valuetext", `step ${this.step}`);
    if (this.timer === null) this.status.textContent = texts.join(". ");
    const link = this.root.querySelector("a.moment");
    link.href = `#replay=${this.panels.map((side) => side.policy.value).join(",")}&step=${this.step}`;
  }

  spoken(episode, step) {
    const places = Array.from({ length: episode.n_agents }, (_, robot) => {
      const [row, col] = episode.place(step, robot);
      return `robot ${robot + 1} in row ${row}, column ${col}`;
    });
    return `house of ${episode.rows} by ${episode.cols} cells; ${places.join("; ")}`;
  }

  // A link to a moment: #replay=FIRST,SECOND&step=STEP.
  follow() {
    const wanted = new URLSearchParams(window.location.hash.slice(1));
    if (!wanted.has("replay")) return;
    wanted.get("replay").split(",").forEach((index, place) => {
      const side = this.panels[place];
      if (side && (index === "" || this.recordings[index])) {
        side.policy.value = index;
        this.choose(side, false);
      }
    });
    this.go(Number.parseInt(wanted.get("step"), 10) || 0);
  }

  toggle() {
    if (this.timer !== null) {
      window.clearInterval(this.timer);
      this.timer = null;
    } else {
      if (this.step >= Number(this.slider.max)) this.step = 0;
      this.timer = window.setInterval(() => {
        if (this.step >= Number(this.slider.max)) this.toggle();
        else this.go(this.step + 1);
      }, 100);
    }
    this.playButton.textContent = this.timer === null ? "play" : "pause";
    this.draw();
  }

  key(event) {
    if (event.target.matches("select, a") || event.ctrlKey || event.metaKey || event.altKey) return;
    const last = Number(this.slider.max);
    const moves = {
      ArrowRight: this.step + (event.shiftKey ? 10 : 1),
      ArrowLeft: this.step - (event.shiftKey ? 10 : 1),
      PageDown: this.step + 10,
      PageUp: this.step - 10,
      Home: 0,
      End: last,
    };
    if (event.key in moves) this.go(moves[event.key]);
    else if (event.key === " " && event.target !== this.playButton) this.toggle();
    else return;
    event.preventDefault();
  }
}

document.addEventListener("DOMContentLoaded", () => {
  const root = document.querySelector("#replays .player");
  if (root) {
    const recordings = JSON.parse(document.querySelector("#recordings").textContent);
    window.player = new Player(root, recordings);
  }
});
