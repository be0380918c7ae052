// The pointer on the map: what is a click, what is a drag, a pinch or a turn of the wheel. A drag is never a click.

const SLOP_PX = { mouse: 4, pen: 6, touch: 10 }; // how far a pointer may move and still click
const WHEEL = .0016, PINCH = .012;               // of ln(zoom) a pixel of the wheel; of a pinch on a touchpad
const LINE_PX = 16, CLICK_AFTER_MS = 400;

// `target` has zoomBy(factor, px, py), panBy(dx, dy), take(px, py, event), hover(px, py, event) and isWhole(); and
// grab(px, py, kind), which gives what a drag from there moves (null: the map), and dragStop(grabbed, px, py).
export function follow(canvas, target) {
  const pointers = new Map();
  let dragging = false, draggedAt = -Infinity, pinched = null, grabbed = null;

  const inside = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  const pinch = () => {
    const [[ax, ay], [bx, by]] = [...pointers.values()].map(({ at }) => at);
    return { apart: Math.max(1, Math.hypot(ax - bx, ay - by)), x: (ax + bx) / 2, y: (ay + by) / 2 };
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    if (!pointers.size) { dragging = false; draggedAt = -Infinity; }
    const at = inside(event);
    pointers.set(event.pointerId, { at, began: at, kind: event.pointerType });
    grabbed = pointers.size === 1 ? target.grab(...at, event.pointerType) : null;
    if (pointers.size === 2) { pinched = pinch(); dragging = true; }
  });

  // A finger on something that can be moved does not scroll the page.
  canvas.addEventListener("touchstart", (event) => {
    const at = event.touches.length === 1 ? inside(event.touches[0]) : null;
    if (at && target.grab(...at, "touch") !== null) event.preventDefault();
  }, { passive: false });

  canvas.addEventListener("pointermove", (event) => {
    const at = inside(event), pointer = pointers.get(event.pointerId);
    if (!pointer) { if (event.pointerType !== "touch") target.hover(...at, event); return; }
    const [x, y] = pointer.at;
    pointer.at = at;
    if (pointers.size === 2) {
      const now = pinch();
      target.panBy(now.x - pinched.x, now.y - pinched.y);
      target.zoomBy(now.apart / pinched.apart, now.x, now.y);
      pinched = now;
    } else if (pointers.size === 1) {
      if (!dragging && Math.hypot(at[0] - pointer.began[0], at[1] - pointer.began[1]) > (SLOP_PX[pointer.kind] ?? SLOP_PX.mouse)) {
        dragging = true;
        target.hover(null);
        canvas.setPointerCapture?.(event.pointerId);
        if (grabbed === null) target.panBy(at[0] - pointer.began[0], at[1] - pointer.began[1]);
      } else if (dragging && grabbed === null) target.panBy(at[0] - x, at[1] - y);
      if (dragging && grabbed !== null) target.dragStop(grabbed, ...at);
    }
    canvas.classList.toggle("dragging", dragging);
  });

  const release = (event) => {
    if (!pointers.delete(event.pointerId) || pointers.size) return;
    if (dragging) draggedAt = performance.now();
    else if (grabbed !== null && event.pointerType === "touch" && event.type === "pointerup") target.take(...inside(event), event); // it gets no click
    dragging = false;
    grabbed = null;
    canvas.classList.remove("dragging");
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointerleave", (event) => { if (!pointers.has(event.pointerId)) target.hover(null); });

  canvas.addEventListener("click", (event) => {
    const dragged = performance.now() - draggedAt < CLICK_AFTER_MS;
    draggedAt = -Infinity;
    if (dragged || event.detail > 1) return; // the second click of a double click says nothing new
    target.take(...inside(event), event);
  });

  canvas.addEventListener("wheel", (event) => {
    const pixels = event.deltaY * (event.deltaMode === 1 ? LINE_PX : event.deltaMode === 2 ? canvas.clientHeight : 1);
    if (target.isWhole() && pixels > 0 && !event.ctrlKey) return; // nothing left to zoom out of: the page scrolls
    event.preventDefault();
    target.zoomBy(Math.exp(-pixels * (event.ctrlKey ? PINCH : WHEEL)), ...inside(event));
  }, { passive: false });
}
