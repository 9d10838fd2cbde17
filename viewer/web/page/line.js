// A line over the picture between two pictures, moved by drags and arrow keys.

/**
 * Let a line be moved; `set` is called with its place, 0-1 from the left.
 *
 * @param {HTMLElement} line
 * @param {() => number} get its place
 * @param {(place: number) => void} set
 */
export function slide(line, get, set) {
  const move = (place) => set(Math.min(Math.max(place, 0), 1));
  line.addEventListener('pointerdown', (event) => line.setPointerCapture(event.pointerId));
  line.addEventListener('pointermove', (event) => {
    if (line.hasPointerCapture(event.pointerId)) move(event.clientX / innerWidth);
  });
  line.addEventListener('keydown', (event) => {
    const steps = { ArrowLeft: get() - 0.02, ArrowRight: get() + 0.02, Home: 0, End: 1 };
    if (!(event.key in steps)) return;
    event.preventDefault();
    move(steps[event.key]);
  });
}
