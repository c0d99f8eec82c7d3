// The figures of docs/viewer.md: `npm run measure`. Needs a machine that does nothing else.
import { loadavg } from 'node:os';
import { clicks } from './files.mjs';
import { complete, openPage, pause, startBrowser, startServer, upload } from './setup.mjs';

const at = (sorted, part) => sorted[Math.round(part * (sorted.length - 1))].toFixed(0);
const spread = (values) => {
  const sorted = [...values].sort((a, b) => a - b);
  return `${at(sorted, 0)} to ${at(sorted, 1)}, median ${at(sorted, 0.5)} (${sorted.length})`;
};
const report = (what, value) => console.log(`${what}: ${value}; load ${loadavg()[0].toFixed(1)}`);

const [server, browser] = await Promise.all([startServer(), startBrowser()]);
// The listener below is a script of ours that the policy of the page would refuse.
const open = (options) => openPage(browser, server.address, { bypassCSP: true, ...options });

/** Milliseconds from the click on the demo song to its first frames on screen. */
async function firstFrames() {
  const { page } = await open({ viewport: { width: 1280, height: 800 } });
  const took = [];
  for (let i = 0; i < 5; i++) {
    took.push(
      await page.evaluate(async () => {
        const { player } = window.bailando;
        player.unload();
        const begun = performance.now();
        document.querySelector('#demo').click();
        while (player.available === 0) await new Promise(requestAnimationFrame);
        await new Promise(requestAnimationFrame);
        return performance.now() - begun;
      }),
    );
    await complete(page);
  }
  await page.context().close();
  return `${spread(took)} ms, the first ${took[0].toFixed(0)}`;
}

/**
 * Milliseconds that the dance is ahead of the sound: each click is heard as it leaves the audio
 * graph, and compared with where the clock of the pictures was then. The graph's own latency, which
 * playback without it does not have, is part of the figure.
 */
async function sync() {
  const { page } = await open({ viewport: { width: 320, height: 640 } });
  await upload(page, 'clicks.wav', clicks(30));
  await complete(page);
  await pause(page);
  const errors = await page.evaluate(async () => {
    const { player, stage } = window.bailando;
    const listener = `registerProcessor('listener', class extends AudioWorkletProcessor {
      last = -1;
      process([[samples]]) {
        samples?.forEach((sample, i) => {
          const time = currentTime + i / sampleRate;
          if (Math.abs(sample) < 0.2 || time - this.last < 0.25) return;
          this.port.postMessage((this.last = time));
        });
        return true;
      }
    })`;
    const context = new AudioContext();
    const address = URL.createObjectURL(new Blob([listener], { type: 'text/javascript' }));
    await context.audioWorklet.addModule(address);
    const source = context.createMediaElementSource(player.element);
    const ear = new AudioWorkletNode(context, 'listener');
    source.connect(ear).connect(context.destination);
    source.connect(context.destination);
    const [heard, drawn] = [[], []];
    ear.port.onmessage = ({ data }) => {
      const { contextTime, performanceTime } = context.getOutputTimestamp();
      heard.push(performanceTime + 1000 * (data - contextTime));
    };
    const shown = stage.onframe;
    stage.onframe = (now, seconds) => {
      const more = shown(now, seconds);
      drawn.push([now, player.clock.time]);
      return more;
    };
    player.seek(0);
    await player.play();
    while (player.tick(performance.now()) < 29) await new Promise(requestAnimationFrame);
    player.pause();
    return heard.slice(2).flatMap((wall) => {
      const [before, after] = [drawn.findLast(([t]) => t <= wall), drawn.find(([t]) => t > wall)];
      if (!before || !after) return [];
      const share = (wall - before[0]) / (after[0] - before[0]);
      const dance = before[1] + share * (after[1] - before[1]);
      return [1000 * (dance - Math.round(dance / 0.5) * 0.5)];
    });
  });
  await page.context().close();
  return `${spread(errors)} ms`;
}

/** Pictures a second while the demo song is danced. */
async function pictures(width, height) {
  const { page } = await open({ viewport: { width, height } });
  await page.click('#demo');
  await complete(page);
  const rate = await page.evaluate(async () => {
    const { player, stage } = window.bailando;
    let count = 0;
    const shown = stage.onframe;
    stage.onframe = (now, seconds) => (count++, shown(now, seconds));
    player.seek(2);
    await player.play();
    await new Promise((resolve) => setTimeout(resolve, 1000));
    count = 0;
    await new Promise((resolve) => setTimeout(resolve, 10_000));
    return count / 10;
  });
  await page.context().close();
  return rate.toFixed(1);
}

report('first frames of the demo song after the click', await firstFrames());
report('dance ahead of the sound, at each click', await sync());
for (const size of [
  [390, 844],
  [1280, 800],
])
  report(`pictures a second at ${size.join('x')}`, await pictures(...size));
await browser.close();
server.stop();
