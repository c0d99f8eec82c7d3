import { expect, test } from 'vitest';
import { MediaClock, type Transport } from '../src/audio/clock';

/** A song whose time moves in steps, as that of some browsers does. */
function stepping(step: number) {
  let wall = 0;
  const media = {
    playbackRate: 1,
    paused: false,
    seeking: false,
    get currentTime() {
      return Math.floor((wall * media.playbackRate) / 1000 / step) * step;
    },
    advance: (to: number) => (wall = to),
  };
  return media as unknown as Transport & { advance(to: number): void; playbackRate: number };
}

test.each([1, 0.25])('the clock is smooth and near the sound at speed %f', (rate) => {
  const media = stepping(0.02);
  media.playbackRate = rate;
  const clock = new MediaClock();
  let last = 0;
  for (let picture = 1; picture < 600; picture++) {
    const now = (picture * 1000) / 60;
    media.advance(now);
    const time = clock.read(media, now);
    expect(Math.abs(time - (now / 1000) * rate)).toBeLessThan(0.03);
    if (picture > 60) expect(time - last).toBeGreaterThan(0);
    last = time;
  }
});

test('the clock follows a jump at once', () => {
  const media = stepping(0.01);
  const clock = new MediaClock();
  media.advance(1000);
  clock.read(media, 1000);
  media.advance(5000);
  expect(clock.read(media, 1016)).toBe(media.currentTime);
});
