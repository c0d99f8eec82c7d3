// The page in a real browser: `make web-test`.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { clicks, silence, vrm } from './files.mjs';
import {
  complete,
  danced,
  drawn,
  openPage,
  pages,
  pause,
  setLength,
  startServer,
  upload,
  wrist,
} from './setup.mjs';

const { onPage, running } = pages();
const state = (page) =>
  page.evaluate(() => {
    const { player, bar } = window.bailando;
    return {
      playing: player.playing,
      time: player.tick(performance.now()),
      rate: player.rate,
      mirror: bar.mirror,
      loop: player.loop,
      duration: player.duration,
    };
  });
onPage('the demo song is danced', {}, async (page, context) => {
  const still = await wrist(page);
  const took = await page.evaluate(async () => {
    const { player } = window.bailando;
    const begun = performance.now();
    document.querySelector('#demo').click();
    while (player.available === 0) await new Promise(requestAnimationFrame);
    await new Promise(requestAnimationFrame);
    return performance.now() - begun;
  });
  context.diagnostic(`first frames on screen after ${took.toFixed(0)} ms`);
  await page.waitForFunction(() => window.bailando.player.tick(performance.now()) > 1);
  assert.notDeepEqual(await wrist(page), still);
  await complete(page);
  assert.equal(await page.textContent('#tempo'), '104 BPM · 4/4');
  const { duration } = await state(page);
  assert.ok(Math.abs(duration - 30.1) < 0.2, String(duration));
});

onPage(
  'the dance follows the sound within 30 ms',
  { viewport: { width: 320, height: 640 } },
  async (page, context) => {
    await upload(page, 'clicks.wav', clicks(12));
    await complete(page);
    const errors = await page.evaluate(async () => {
      const { player, stage } = window.bailando;
      const found = [];
      const shown = stage.onframe;
      // What is drawn is what the clock says at the beginning of the picture.
      stage.onframe = (now, seconds) => {
        const more = shown(now, seconds);
        const drawn = player.clock.time;
        found.push(1000 * (drawn - player.element.currentTime));
        return more;
      };
      player.seek(0);
      await player.play();
      while (player.tick(performance.now()) < 8) await new Promise(requestAnimationFrame);
      player.pause();
      return found
        .slice(1)
        .map(Math.abs)
        .sort((a, b) => a - b);
    });
    const at = (part) => errors[Math.floor(part * (errors.length - 1))].toFixed(1);
    context.diagnostic(
      `${errors.length} pictures: median ${at(0.5)} ms, p95 ${at(0.95)} ms, ` + `most ${at(1)} ms`,
    );
    assert.ok(errors.length >= 4 && Number(at(0.95)) <= 30, at(0.95));
  },
);

onPage('playback by keyboard', {}, async (page) => {
  await upload(page, 'clicks.wav', clicks(8));
  await complete(page);
  await pause(page);
  await page.focus('#timeline');
  await page.keyboard.press('Home');
  await page.keyboard.press('ArrowRight');
  await page.keyboard.press('ArrowRight');
  assert.ok(Math.abs((await state(page)).time - 2) < 0.02);
  await page.keyboard.press('Shift+ArrowLeft');
  assert.ok(Math.abs((await state(page)).time - (2 - 1 / 60)) < 0.01);
  await page.keyboard.press('[');
  await page.keyboard.press('ArrowRight');
  await page.keyboard.press(']');
  const [from, to] = (await state(page)).loop;
  assert.ok(from > 1.9 && from < 2 && to - from > 0.95 && to - from < 1.05, `${from} ${to}`);
  await page.keyboard.press('-');
  await page.keyboard.press('-');
  assert.equal((await state(page)).rate, 0.5);
  assert.ok(await page.evaluate(() => window.bailando.player.element.preservesPitch));
  await page.keyboard.press(' ');
  const seen = [];
  const around = () => seen.some((time, i) => i > 0 && time < seen[i - 1] - 0.3);
  const until = Date.now() + 30_000;
  while (Date.now() < until && !around()) {
    seen.push((await state(page)).time);
    await page.waitForTimeout(50);
  }
  assert.ok(around(), String(seen));
  assert.ok((await state(page)).playing);
  assert.ok(Math.min(...seen) >= from - 0.05 && Math.max(...seen) <= to + 0.3, String(seen));
  await page.keyboard.press(' ');
  const before = await wrist(page);
  await page.keyboard.press('m');
  await drawn(page);
  assert.ok((await state(page)).mirror);
  assert.notDeepEqual(await wrist(page), before);
  await page.keyboard.press('?');
  assert.ok(await page.isVisible('#keys'));
  await page.click('#keys button');
  assert.ok(await page.isHidden('#keys'));
  const label = await page.getAttribute('#timeline', 'aria-valuetext');
  assert.match(label, /^0:0\d\.\d of 0:08\.\d$/);
});

onPage(
  'a loop to the end comes around, and the end is followed by the beginning',
  {},
  async (page) => {
    await upload(page, 'clicks.wav', clicks(3));
    await complete(page);
    await pause(page);
    const play = (loop) =>
      page.evaluate((range) => {
        const { player } = window.bailando;
        player.loop = range;
        player.seek(2.6);
        return player.play();
      }, loop);
    await play([2, 3.2]);
    await page.waitForFunction(() => {
      const { player } = window.bailando;
      return player.playing && player.tick(performance.now()) < 2.5;
    });
    assert.ok((await state(page)).time >= 1.9);
    await pause(page);
    await play(null);
    await page.waitForFunction(() => !window.bailando.player.playing);
    assert.ok((await state(page)).time > 2.5);
    await page.click('#play');
    await page.waitForFunction(() => {
      const time = window.bailando.player.tick(performance.now());
      return time > 0.2 && time < 2;
    });
  },
);

onPage('a click on the timeline seeks', {}, async (page) => {
  await upload(page, 'clicks.wav', clicks(8));
  await complete(page);
  await pause(page);
  const box = await page.locator('#timeline').boundingBox();
  await page.mouse.click(box.x + 18 + (box.width - 18) / 2, box.y + 20);
  assert.ok(Math.abs((await state(page)).time - 4) < 0.1);
});

onPage('what the server assumed stays to be read', {}, async (page) => {
  await upload(page, 'silence.wav', silence(3));
  await complete(page);
  assert.match(await page.textContent('#status'), /silen/);
});

onPage('errors are shown in the server’s words', {}, async (page) => {
  await upload(page, 'broken.mp3', Buffer.from('this is no song'));
  await page.waitForSelector('#banner:not([hidden])');
  const said = await page.textContent('#banner-text');
  const asked = await page.request.post(`${running.server.address}generate`, {
    multipart: {
      file: { name: 'broken.mp3', mimeType: 'audio/mpeg', buffer: Buffer.from('this is no song') },
    },
  });
  assert.equal(said, (await asked.json()).error);
  assert.equal(await page.textContent('#status'), '');
  await page.locator('#dance').press('Escape');
  assert.ok(await page.isHidden('#banner'));
  await upload(page, 'long.wav', silence(601));
  await page.waitForSelector('#banner:not([hidden])');
  assert.match(await page.textContent('#banner-text'), /600/);
  assert.equal(await page.getAttribute('body', 'data-state'), 'empty');
  // And the next song is danced all the same.
  await upload(page, 'clicks.wav', clicks(3));
  await complete(page);
  assert.ok(await page.isHidden('#banner'));
});

for (const version of [1, 0]) {
  onPage(`a VRM ${version} character dances as the mannequin does`, {}, async (page) => {
    await page.fill('#seed', '5');
    await upload(page, 'clicks.wav', clicks(3));
    await complete(page);
    await pause(page);
    await page.evaluate(() => window.bailando.player.seek(1.5));
    await drawn(page);
    const directions = () =>
      page.evaluate(() => {
        const { figure } = window.bailando.cast.members[0];
        const place = (joint) => figure.joint(joint, figure.object.position.clone());
        return [
          ['l_shoulder', 'l_elbow'],
          ['r_elbow', 'r_wrist'],
          ['l_hip', 'l_knee'],
          ['r_knee', 'r_ankle'],
        ].map(([a, b]) => place(b).sub(place(a)).normalize().toArray());
      });
    const ours = await directions();
    await upload(page, 'boxes.vrm', vrm(version));
    await page.waitForFunction(() => document.querySelector('[value=own]').checked);
    await drawn(page);
    const theirs = await directions();
    ours.forEach((direction, i) => {
      const cosine = direction.reduce((sum, value, k) => sum + value * theirs[i][k], 0);
      assert.ok(cosine > 0.999, `limb ${i}: ${cosine}`);
    });
  });
}

onPage('a file that is no character is refused in words', {}, async (page) => {
  await upload(page, 'nothing.glb', Buffer.from('glTF but not really'));
  await page.waitForSelector('#banner:not([hidden])');
  assert.match(await page.textContent('#banner-text'), /^The file is damaged, or no VRM/);
  await page.click('#dismiss');
  const empty = vrm(1)
    .toString('latin1')
    .replaceAll('bone_', 'none_')
    .replace(/VRMC_vrm/g, 'VRMC_xyz');
  await upload(page, 'bones.glb', Buffer.from(empty, 'latin1'));
  await page.waitForSelector('#banner:not([hidden])');
  assert.match(await page.textContent('#banner-text'), /lacks bones for pelvis/);
  assert.ok(await page.isChecked('[value=female]'));
});

onPage('dancers stand side by side', {}, async (page) => {
  await page.click('#count label:nth-child(3)');
  await upload(page, 'clicks.wav', clicks(3));
  await complete(page);
  const seeds = await page.locator('#dancers label').allTextContents();
  assert.equal(new Set(seeds).size, 3, String(seeds));
  const places = await page.evaluate(() =>
    window.bailando.cast.members.map(({ figure }) => figure.object.position.x),
  );
  assert.deepEqual(places, [-2, 0, 2]);
});

onPage('every format is downloaded, and the command is copied', {}, async (page, context) => {
  await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
  await page.fill('#seed', '11');
  await upload(page, 'my song.wav', clicks(2));
  await complete(page);
  const formats = await page
    .locator('#format option')
    .evaluateAll((all) => all.map((o) => o.value));
  assert.ok(formats.includes('json') && formats.includes('bvh'));
  context.diagnostic(`formats: ${formats.join(', ')}`);
  for (const format of formats) {
    await page.selectOption('#format', format);
    const [download] = await Promise.all([page.waitForEvent('download'), page.click('#download')]);
    assert.equal(download.suggestedFilename(), `my song.${format}`);
    const parts = [];
    for await (const part of await download.createReadStream()) parts.push(part);
    const content = Buffer.concat(parts);
    assert.ok(content.length > 1000, `${format}: ${content.length}`);
    if (format === 'json') assert.equal(JSON.parse(content).seed, 11);
    if (format === 'bvh') assert.match(content.toString('latin1', 0, 9), /^HIERARCHY/);
    await page.waitForFunction(() => !document.querySelector('#download').disabled);
  }
  await page.selectOption('#format', 'bvh');
  await page.click('#curl');
  await page.waitForFunction(() =>
    /copied/.test(document.querySelector('#result-status').textContent),
  );
  const command = await page.evaluate(() => navigator.clipboard.readText());
  assert.equal(
    command,
    `curl --fail-with-body -F 'file=@"my song.wav"' -F seed=11 -F format=bvh ` +
      `${running.server.address}generate -o 'my song.bvh'`,
  );
});

onPage('a recording is danced', { permissions: ['microphone'] }, async (page) => {
  await page.click('#record');
  await page.waitForTimeout(2500);
  await page.click('#record');
  await complete(page);
  const { duration } = await state(page);
  assert.ok(duration > 1.5 && duration < 4, String(duration));
});

onPage(
  'a phone shows everything within its width',
  {
    viewport: { width: 390, height: 844 },
    hasTouch: true,
    colorScheme: 'dark',
  },
  async (page) => {
    await setLength(page, 2);
    await page.click('#hint-demo');
    await danced(page);
    const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(overflow <= 0, String(overflow));
    for (const id of ['play', 'loop', 'mirror', 'speed', 'mute', 'demo', 'dance', 'download']) {
      await page.locator(`#${id}`).scrollIntoViewIfNeeded();
      assert.ok(await page.locator(`#${id}`).isVisible(), id);
    }
    await complete(page);
  },
);

onPage(
  'less motion on request, and names for screen readers',
  { reducedMotion: 'reduce' },
  async (page) => {
    await upload(page, 'clicks.wav', clicks(2));
    await complete(page);
    assert.equal((await state(page)).playing, false);
    const nameless = await page.evaluate(() =>
      [...document.querySelectorAll('button, input, select, [role=slider], dialog, [role=img]')]
        .filter((element) => !element.hidden)
        .filter((element) => {
          const label = element.getAttribute('aria-label') ?? element.textContent.trim();
          return !label && !element.labels?.length && !element.getAttribute('aria-labelledby');
        })
        .map((element) => element.outerHTML),
    );
    assert.deepEqual(nameless, []);
    const speeds = await page.locator('#speed option').evaluateAll((all) => all.map((o) => o.text));
    assert.deepEqual(speeds, ['0.25×', '0.5×', '0.75×', '1×', '1.25×']);
  },
);

onPage('twenty dances leave nothing behind', {}, async (page, context) => {
  const session = await page.context().newCDPSession(page);
  const used = async () => {
    await session.send('HeapProfiler.collectGarbage');
    const { usedSize, backingStorageSize = 0 } = await session.send('Runtime.getHeapUsage');
    const { geometries, textures } = await page.evaluate(() => window.bailando.stage.memory);
    return { megabytes: (usedSize + backingStorageSize) / 1e6, geometries, textures };
  };
  const sizes = [];
  await setLength(page, 2);
  for (let dance = 0; dance < 21; dance++) {
    await page.click(`#count label:nth-child(${1 + (dance % 2)})`);
    await (dance === 0 ? page.click('#demo') : page.click('#dance'));
    await page.waitForFunction(
      (all) => {
        const { cast, running, dancers } = window.bailando;
        return (
          !running &&
          dancers.length === all &&
          cast.members.length === all &&
          dancers.every(({ state }) => state === 'done')
        );
      },
      1 + (dance % 2),
    );
    await pause(page);
    await page.waitForTimeout(100);
    if (dance % 2 === 0) sizes.push(await used());
  }
  const [first, last] = [sizes[1], sizes.at(-1)];
  context.diagnostic(sizes.map(({ megabytes }) => megabytes.toFixed(1)).join(' ') + ' MB');
  assert.ok(last.megabytes < first.megabytes + 3, JSON.stringify(sizes));
  assert.deepEqual([last.geometries, last.textures], [first.geometries, first.textures]);
});

test('a server with keys asks for one', async () => {
  if (/^http/.test(process.env.BAILANDO ?? '')) return;
  const keyed = await startServer('--api-key', 'open-sesame');
  try {
    const { page } = await openPage(running.browser, keyed.address);
    await upload(page, 'clicks.wav', clicks(2));
    await page.waitForSelector('#key-field:not([hidden])');
    await page.fill('#key', 'open-sesame');
    await page.click('#dance');
    await complete(page);
  } finally {
    keyed.stop();
  }
});
