// A joystick for touch screens, to fly.

/**
 * Let a finger on an element push the camera.
 *
 * @param {HTMLElement} element with a knob
 * @param {(right: number, forward: number) => void} push called with shares of the full speed, from
 *   -1 to 1
 */
export function joystick(element, push) {
  const { style } = element.firstElementChild;
  const lean = (x, y) => {
    const radius = element.clientWidth / 2;
    const much = Math.max(Math.hypot(x, y) / radius, 1);
    style.translate = `${x / much}px ${y / much}px`;
    push(x / much / radius, -y / much / radius);
  };
  const follow = ({ pointerId, clientX, clientY }) => {
    if (!element.hasPointerCapture(pointerId)) return;
    const { left, top, width, height } = element.getBoundingClientRect();
    lean(clientX - left - width / 2, clientY - top - height / 2);
  };
  element.addEventListener('pointerdown', (event) => {
    element.setPointerCapture(event.pointerId);
    follow(event);
  });
  element.addEventListener('pointermove', follow);
  element.addEventListener('lostpointercapture', () => lean(0, 0));
}
