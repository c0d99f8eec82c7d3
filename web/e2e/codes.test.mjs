// The choreographic memory, the editor and VRM animations in a real browser: `make web-test`.
import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { clicks } from './files.mjs';
import { complete, drawn, pages, pause, upload, wrist } from './setup.mjs';

const { onPage } = pages();

/** Waits until the memory shows what was asked for, and returns its words. */
const told = async (page, pattern) => {
  await page.waitForFunction(
    (source) => new RegExp(source).test(document.querySelector('#memory-speed').textContent),
    pattern,
  );
  return page.textContent('#memory-speed');
};
const codes = (page) => page.evaluate(() => window.bailando.dancers[0].dance.codes);
const at = async (page, time) => {
  await page.evaluate((seconds) => window.bailando.player.seek(seconds), time);
  await drawn(page);
  return wrist(page);
};

onPage(
  'a held pair stands still, and a pair after it moves the figure',
  {},
  async (page, context) => {
    await page.click('#memory-open');
    const held = await told(page, '^Held: ');
    const speed = Number(/by ([\d.]+) m/.exec(held)[1]);
    assert.ok(speed < 0.15, held);
    const still = await wrist(page);
    await page.click('#memory-next button, #memory-codes button:nth-child(9)');
    await page.fill('#memory-then-lower', '9');
    await page.press('#memory-then-lower', 'Enter');
    const moved = await told(page, 'The change: ');
    context.diagnostic(`${held} / ${moved}`);
    const change = Number(/change: ([\d.]+) m/.exec(moved)[1]);
    assert.ok(change > 4 * speed, moved);
    await page.waitForFunction((from) => {
      const { figure } = window.bailando.cast.members[0];
      const now = figure.joint('l_wrist', figure.object.position.clone()).toArray();
      return Math.hypot(...now.map((value, i) => value - from[i])) > 0.05;
    }, still);
    // Any code of either half; a number beyond the last is none.
    await page.click('#memory-half label:nth-child(2)');
    await page.selectOption('#memory-sort', 'number', { force: true }).catch(() => undefined);
    const chosen = page.locator('#memory-codes button').nth(3);
    await chosen.click();
    assert.equal(await page.inputValue('#memory-lower'), await chosen.getAttribute('data-code'));
    assert.equal(await chosen.getAttribute('aria-pressed'), 'true');
    await page.fill('#memory-upper', '99999');
    await page.press('#memory-upper', 'Enter');
    const refused = await page.locator('#memory-upper').evaluate((all) => all.validationMessage);
    assert.match(refused, /^A whole number from 0 to \d+\.$/);
    await page.click('#memory-close');
    assert.ok(await page.isVisible('#form'));
  },
);

onPage('how often training used a code, and what followed, lead on', {}, async (page) => {
  await page.click('#memory-open');
  await told(page, '^Held: ');
  if (await page.isHidden('#memory-uses')) return;
  assert.match(await page.textContent('#memory-used'), /^Training used upper code \d+: \d+ times/);
  const next = page.locator('#memory-next button').first();
  const code = /^\d+/.exec(await next.textContent())[0];
  await next.click();
  assert.equal(await page.inputValue('#memory-then-upper'), code);
  await told(page, 'The change: ');
  const beside = page.locator('#memory-beside button').first();
  const other = /^\d+/.exec(await beside.textContent())[0];
  await beside.click();
  assert.equal(await page.inputValue('#memory-lower'), other);
  assert.equal(await page.inputValue('#memory-then-upper'), '');
});

onPage('a block is replaced and repeated, and the dance changes at once', {}, async (page) => {
  await page.fill('#seed', '3');
  await upload(page, 'clicks.wav', clicks(6));
  await complete(page);
  await pause(page);
  const before = await codes(page);
  const pose = await at(page, 3);
  await page.click('#edit');
  await page.evaluate(() => {
    const blocks = document.querySelector('#blocks');
    window.bailando.editor.blocks.select({ from: 0, to: 1, halves: ['upper'] });
    blocks.scrollLeft = 360;
  });
  const box = await page.locator('#blocks canvas').boundingBox();
  const x = (pair) => box.x + 18 + ((box.width - 18) * (pair + 0.5)) / 45;
  // Pairs 20 to 25 of both halves: 2.7 to 3.5 s.
  await page.mouse.move(x(20), box.y + 6);
  await page.mouse.down();
  await page.mouse.move(x(25), box.y + 30, { steps: 4 });
  await page.mouse.up();
  assert.match(await page.textContent('#edit-what'), /^Both 2\.7–3\.5 s$/);
  const sent = page.waitForRequest(/generate\/stream/);
  // Where it is heard from: a busy machine would read the time too late.
  await page.evaluate(() => {
    const { player } = window.bailando;
    const seek = player.seek.bind(player);
    player.seek = (time) => seek((window.sought = time));
  });
  await page.fill('#edit-code', '7');
  await page.click('#edit-replace');
  assert.ok(!(await sent).postData().includes('filename'), 'the song is not sent again');
  await page.waitForFunction(() => window.bailando.dancers[0].dance.codes.upper[20] === 7);
  const replaced = await codes(page);
  assert.deepEqual(replaced.lower.slice(20, 26), Array(6).fill(7));
  assert.deepEqual(replaced.upper.slice(0, 20), before.upper.slice(0, 20));
  assert.deepEqual(replaced.upper.slice(26), before.upper.slice(26));
  // The song goes on from shortly before the change.
  await page.waitForFunction(() => window.bailando.player.playing);
  const time = await page.evaluate(() => window.sought);
  assert.ok(time > 1.8 && time < 2.7, String(time));
  await pause(page);
  assert.notDeepEqual(await at(page, 3), pose);
  await page.click('#edit-repeat');
  await page.waitForFunction(() => window.bailando.dancers[0].dance.codes.upper[31] === 7);
  assert.equal((await codes(page)).upper.length, before.upper.length);
  const shown = await page.evaluate(() => window.bailando.dancers[0].dance.frames);
  assert.equal(shown, 360);
  // What is downloaded is what is shown.
  await pause(page);
  await page.selectOption('#format', 'json');
  const [download] = await Promise.all([page.waitForEvent('download'), page.click('#download')]);
  const file = JSON.parse(await readFile(await download.path(), 'utf8'));
  assert.deepEqual(file.codes, await codes(page));
  for (let step = 0; step < 2; step++) await page.click('#edit-undo');
  await page.waitForFunction((codes) => {
    const { upper } = window.bailando.dancers[0].dance.codes;
    return JSON.stringify(upper) === JSON.stringify(codes);
  }, before.upper);
  // Undone choreography plays on by itself, as changed choreography does.
  await page.waitForFunction(() => window.bailando.player.playing);
  await pause(page);
  const again = await at(page, 3);
  const apart = Math.hypot(...again.map((value, axis) => value - pose[axis]));
  assert.ok(apart < 0.02, `${apart} m`);
});

onPage('blocks are chosen by keys, and wrong codes are refused', {}, async (page) => {
  await upload(page, 'clicks.wav', clicks(3));
  await complete(page);
  await pause(page);
  await page.keyboard.press('e');
  await page.focus('#blocks');
  await page.keyboard.press('ArrowRight');
  const first = await page.textContent('#edit-what');
  assert.match(first, /^Upper 0\.\d–\d\.\d s$/);
  await page.keyboard.press('ArrowDown');
  assert.match(await page.textContent('#edit-what'), /^Lower /);
  const before = await codes(page);
  await page.fill('#edit-code', '99999');
  await page.press('#edit-code', 'Enter');
  await page.waitForFunction(() => !document.querySelector('#edit-code').validity.valid);
  assert.deepEqual(await codes(page), before);
});

onPage('a VRM animation that was taken along is danced as it was', {}, async (page) => {
  await page.fill('#seed', '4');
  await upload(page, 'clicks.wav', clicks(4));
  await complete(page);
  await pause(page);
  const ours = [];
  for (const time of [1, 2, 3]) ours.push(await at(page, time));
  await page.selectOption('#format', 'vrma');
  const [download] = await Promise.all([page.waitForEvent('download'), page.click('#download')]);
  const content = await readFile(await download.path());
  await page.reload();
  await page.waitForFunction(() => window.bailando?.cast.members.length > 0);
  await upload(page, 'dance.vrma', content);
  await page.waitForFunction(() => window.bailando.player.duration > 3.9);
  await pause(page);
  for (const [i, time] of [1, 2, 3].entries()) {
    const theirs = await at(page, time);
    const apart = Math.hypot(...theirs.map((value, axis) => value - ours[i][axis]));
    assert.ok(apart < 0.08, `${time} s: ${apart} m`);
  }
  assert.ok(await page.isHidden('#result'));
  await upload(page, 'none.vrma', Buffer.from('glTF but not really'));
  await page.waitForSelector('#banner:not([hidden])');
});
