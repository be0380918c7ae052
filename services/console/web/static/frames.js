// When the page draws: a few times a second, all that has changed in one frame. The browser asks for no frame of a page
// that is not seen, so a hidden page draws nothing, and draws what it missed when it is seen again.

const EVERY_MS = 250, FLYING_MS = 100;
const due = new Set();
const onFrame = [];
let drawnAt = -Infinity, isFlying = () => false, fly = () => {};

// Draws with the next frame, once, however often it is asked for.
export function redraw(...draws) { for (const draw of draws) due.add(draw); }

// Called with each frame.
export const everyFrame = (draw) => onFrame.push(draw);

// What is in motion: drawn more often, and alone, while it moves.
export function setFlying(moves, draw) { isFlying = moves; fly = draw; }

function frame(wall) {
  wait();
  if (isFlying()) fly();
  if (wall - drawnAt < EVERY_MS - FLYING_MS / 2) return;
  drawnAt = wall;
  const draws = [...due];
  due.clear();
  for (const draw of [...draws, ...onFrame]) {
    try { draw(); } catch (error) { reportError(error); } // the others are drawn all the same
  }
}

// Frames stand on a grid of time, so that the seconds of a clock change evenly.
function wait() {
  const every = isFlying() ? FLYING_MS : EVERY_MS;
  setTimeout(() => requestAnimationFrame(frame), every - (performance.now() % every));
}

wait();
