// Pictures of every state of the page, to be looked at: `npm run screens [part of a name ..]`.
//
// They come to e2e/out: NAME-desktop-light.png, NAME-phone-dark.png and so on. SCREENS=desktop-light
// takes one kind alone. What a page complains about is said, and so is what axe-core finds.
import { spawnSync } from 'node:child_process';
import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { character, clicks, mixamo, silence, vrm } from './files.mjs';
import { complete, danced, drawn, openPage, pause, settings } from './setup.mjs';
import { setLength, startBrowser, startServer, upload } from './setup.mjs';

const OUT = join(import.meta.dirname, 'out');
const KINDS = {
  'desktop-light': { viewport: { width: 1280, height: 800 }, colorScheme: 'light' },
  'desktop-dark': { viewport: { width: 1280, height: 800 }, colorScheme: 'dark' },
  'phone-light': { viewport: { width: 390, height: 844 }, colorScheme: 'light', hasTouch: true },
  'phone-dark': { viewport: { width: 390, height: 844 }, colorScheme: 'dark', hasTouch: true },
};
const axe = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');
const banner = (page) => page.waitForSelector('#banner:not([hidden])');
const seek = (page, time) => page.evaluate((at) => window.bailando.player.seek(at), time);
const still = async (page, time) => {
  await pause(page);
  await seek(page, time);
  await drawn(page);
};
const song = (page, name = 'clicks.wav', seconds = 8) => upload(page, name, clicks(seconds));
const demo = async (page, seconds = 12) => {
  await setLength(page, seconds);
  await page.fill('#seed', '7');
  await page.click('#demo');
  await complete(page);
  await page.waitForFunction(() => /·/.test(document.querySelector('#song-detail').textContent));
  await still(page, 4);
};

/** Each journey takes pictures with `shot(name)` on the way. */
const JOURNEYS = {
  async empty(page, shot) {
    await shot('empty', { audit: true });
    await page.evaluate(() => {
      const data = new DataTransfer();
      data.items.add(new File(['x'], 'x.mp3'));
      document.dispatchEvent(new DragEvent('dragover', { dataTransfer: data, bubbles: true }));
    });
    await shot('drag-over');
    await page.evaluate(() => document.body.classList.remove('drag'));
    for (const [presses, name] of [
      [1, 'focus-skip'],
      [3, 'focus-song'],
      [6, 'focus-dancers'],
    ]) {
      for (let i = 0; i < presses; i++) await page.keyboard.press('Tab');
      await shot(name);
    }
    await page.evaluate(() => document.querySelector('#help').click());
    await shot('keys', { audit: true });
  },
  async dance(page, shot) {
    await page.fill('#seed', '7');
    await page.click('#hint-demo');
    await danced(page);
    await shot('streaming');
    await complete(page);
    await page.waitForFunction(() => window.bailando.player.tick(performance.now()) > 2);
    await shot('dancing');
    await pause(page);
    await shot('paused', { audit: true, full: true });
    await page.click('#timeline', { position: { x: 250, y: 20 } });
    await shot('scrubbed');
    await page.click('#loop');
    await page.click('#mirror');
    await page.selectOption('#speed', '0.25');
    await page.click('#play');
    await page.waitForTimeout(1500);
    await shot('loop-slow-mirror');
    await pause(page);
    for (const look of ['side', 'top']) {
      await page.click(`[data-look=${look}]`);
      await page.waitForTimeout(600);
      await shot(`view-${look}`);
    }
    await page.focus('#timeline');
    await page.keyboard.press('ArrowRight');
    await shot('focus-timeline');
  },
  async files(page, shot, { context }) {
    await context.grantPermissions(['clipboard-read', 'clipboard-write']);
    await demo(page);
    await page.click('#more summary');
    await page.selectOption('#format', 'bvh');
    await page.locator('#download').scrollIntoViewIfNeeded();
    await shot('files', { audit: true, full: true });
    await page.click('#curl');
    await page.waitForFunction(() =>
      /copied/.test(document.querySelector('#result-status').textContent),
    );
    await shot('curl-copied');
    await context.clearPermissions();
    await page.evaluate(() => {
      navigator.clipboard.writeText = () => Promise.reject(new Error('no'));
    });
    await page.click('#curl');
    await banner(page);
    await shot('curl-refused');
  },
  async dancers(page, shot) {
    await setLength(page, 6);
    await page.fill('#seed', '7');
    await page.click('#count label:nth-child(4)');
    await song(page);
    await danced(page);
    await shot('four-listening', { full: true });
    await complete(page);
    await still(page, 3);
    await shot('four-dancers', { audit: true, full: true });
    await page.click('#count label:nth-child(2)');
    if (await page.isVisible('#vary')) await page.selectOption('#vary', 'style');
    await page.click('#dance');
    await complete(page);
    await still(page, 3);
    await shot('two-styles', { full: true });
  },
  async figures(page, shot, { address }) {
    await demo(page);
    await page.click('#figures label:nth-child(2)');
    await drawn(page);
    await shot('broad');
    await upload(page, 'boxes.vrm', vrm(1));
    await page.waitForFunction(() => document.querySelector('[value=own]').checked);
    await drawn(page);
    await shot('vrm', { full: true });
    await upload(page, 'mixamo.glb', mixamo());
    await page.waitForFunction(() => /mixamo/.test(document.body.textContent));
    await drawn(page);
    await shot('glb');
    // A file that the page itself gave.
    const form = { file: { name: 'a.wav', mimeType: 'audio/wav', buffer: clicks(2) } };
    const made = await page.request.post(`${address}generate`, {
      multipart: { ...form, format: 'glb' },
    });
    await upload(page, 'ours.glb', await made.body());
    await page.waitForFunction(() => /ours/.test(document.body.textContent));
    await drawn(page);
    await shot('glb-of-ours');
    await upload(page, 'chair.glb', character([['seat', null, [0, 0.5, 0]]]));
    await banner(page);
    await shot('glb-fails', { audit: true });
    await page.click('#dismiss');
    await upload(page, 'nothing.glb', Buffer.from('glTF but not really'));
    await banner(page);
    await shot('glb-broken');
  },
  async errors(page, shot) {
    await upload(page, 'broken.mp3', Buffer.from('this is no song'));
    await banner(page);
    await shot('broken-file', { audit: true });
    await upload(page, 'long.wav', silence(601));
    await banner(page);
    await shot('long-file');
    await page.click('#dismiss');
    await page.fill('#seed', 'seven');
    await song(page);
    await banner(page);
    await shot('wrong-option');
    await page.fill('#seed', '');
    await upload(page, 'holiday.jpg', Buffer.from('\xff\xd8\xff\xe0 a picture', 'latin1'));
    await banner(page);
    await shot('picture-file');
  },
  async gone(page, shot, { context, server }) {
    await page.waitForTimeout(200);
    await context.setOffline(true);
    await song(page);
    await banner(page);
    await shot('server-gone');
    await context.setOffline(false);
    // A song that is long enough to be still at it.
    await page.click('#dismiss');
    await upload(page, 'song.wav', clicks(60));
    await danced(page);
    server.stop('SIGKILL');
    await banner(page);
    await shot('server-died');
  },
  async busy(page, shot, { address }) {
    const form = { file: { name: 'a.wav', mimeType: 'audio/wav', buffer: clicks(2) } };
    for (let i = 0; i < 2; i++) await page.request.post(`${address}generate`, { multipart: form });
    await song(page);
    await banner(page);
    await shot('server-busy', { audit: true });
  },
  async key(page, shot) {
    await song(page);
    await page.waitForSelector('#key-field:not([hidden])');
    await shot('key-asked', { audit: true, full: true });
    await page.fill('#key', 'wrong');
    await page.keyboard.press('Enter');
    await banner(page);
    await page.waitForFunction(() => !window.bailando.running);
    await shot('key-wrong');
    await page.fill('#key', 'open-sesame');
    await page.keyboard.press('Enter');
    await complete(page);
    await still(page, 2);
    await shot('key-right');
  },
  async loading(page, shot, { context, address }) {
    let loaded = false;
    const loading = { status: 503, json: { error: 'loading', error_type: 'loading' } };
    await context.route('**/info', (route) => (loaded ? route.continue() : route.fulfill(loading)));
    await page.goto(address);
    await page.waitForFunction(() => /loading/.test(document.querySelector('#status').textContent));
    await shot('model-loading');
    loaded = true;
  },
  async record(page, shot, { context }) {
    await context.grantPermissions(['microphone']);
    await page.click('#record');
    await page.waitForTimeout(2500);
    await shot('recording', { audit: true });
    await page.click('#record');
    await complete(page);
    await still(page, 1);
    await shot('recorded');
    await page.evaluate(() => {
      navigator.mediaDevices.getUserMedia = () =>
        Promise.reject(new DOMException('Permission denied', 'NotAllowedError'));
    });
    await page.click('#record');
    await banner(page);
    await shot('record-refused');
    await page.evaluate(() => {
      navigator.mediaDevices.getUserMedia = () =>
        Promise.reject(new DOMException('Requested device not found', 'NotFoundError'));
    });
    await page.click('#record');
    await page.waitForTimeout(300);
    await shot('no-microphone');
  },
  async memory(page, shot) {
    const told = (text) =>
      page.waitForFunction(
        (start) => document.querySelector('#memory-speed').textContent.startsWith(start),
        text,
      );
    await page.click('#memory-open');
    await told('Held: all');
    await drawn(page);
    await shot('memory', { audit: true, full: true });
    await page.fill('#memory-then-upper', '9');
    await page.press('#memory-then-upper', 'Enter');
    await page.waitForFunction(() =>
      /change/.test(document.querySelector('#memory-speed').textContent),
    );
    await shot('memory-pair');
    await page.click('#memory-half label:nth-child(2)');
    await page.locator('#memory-codes button[aria-pressed=true]').focus();
    await page.keyboard.press('ArrowRight');
    await told('Held: all');
    await shot('memory-lower', { full: true });
    await page.fill('#memory-upper', '99999');
    await page.press('#memory-upper', 'Enter');
    await shot('memory-wrong');
  },
  async edit(page, shot) {
    await demo(page);
    await page.click('#edit');
    await shot('edit', { audit: true });
    await page.focus('#blocks');
    for (const key of ['ArrowRight', 'ArrowRight', 'ArrowDown']) await page.keyboard.press(key);
    await shot('edit-chosen');
    const codes = () => page.evaluate(() => window.bailando.dancers[0].dance.codes.lower.join());
    const before = await codes();
    await page.fill('#edit-code', '99999');
    await page.click('#edit-replace');
    await shot('edit-wrong');
    await page.fill('#edit-code', '7');
    await page.click('#edit-replace');
    await page.waitForFunction(
      (old) => window.bailando.dancers[0].dance.codes.lower.join() !== old,
      before,
    );
    await page.waitForTimeout(500);
    await shot('edit-replaced', { full: true });
  },
  async calm(page, shot) {
    await page.emulateMedia({ reducedMotion: 'reduce' });
    await page.reload();
    await page.waitForFunction(() => window.bailando?.cast.members.length > 0);
    await song(page);
    await complete(page);
    await shot('reduced-motion');
  },
  async unusual(page, shot) {
    await song(page, `${'A very long name of a song that nobody has shortened '.repeat(3)}.wav`);
    await complete(page);
    await still(page, 2);
    await shot('long-name', { full: true });
    const aiff = Buffer.concat([Buffer.from('not'), clicks(1)]);
    await page.evaluate(() => window.bailando.player.audio.dispatchEvent(new Event('error')));
    await drawn(page);
    await shot('silent');
    await upload(page, 'none.vrma', aiff);
    await banner(page);
    await shot('vrma-broken');
  },
  async study(page, shot) {
    const folder = mkdtempSync(join(tmpdir(), 'bailando-study-'));
    const { binary, model } = settings();
    const run = (...args) => {
      const done = spawnSync(binary, args, { encoding: 'utf8' });
      if (done.status !== 0) throw new Error(done.stderr);
    };
    for (const name of ['a', 'b', 'songs']) mkdirSync(join(folder, name));
    for (const name of ['first', 'second']) {
      const heard = join(folder, 'songs', `${name}.wav`);
      writeFileSync(heard, clicks(12, name === 'first' ? 0.5 : 0.6));
      ['a', 'b'].forEach((side, seed) => {
        const dance = join(folder, side, `${name}.json`);
        const asked = ['--seed', String(seed), '--model-dir', model];
        run('generate', heard, '-o', dance, ...asked);
      });
    }
    const dirs = ['a', 'b', 'songs'].flatMap((name) => [`--${name}`, join(folder, name)]);
    run('study', ...dirs, '-o', join(folder, 'study'));
    await page.goto(`file://${join(folder, 'study/index.html')}`);
    await shot('study', { audit: true });
    const watch = async () => {
      await page.evaluate(() => document.querySelector('#song').play());
      await page.waitForFunction(() => !document.querySelector('#choose-left').disabled);
    };
    await watch();
    await shot('study-watched');
    await page.keyboard.press('ArrowLeft');
    await watch();
    await page.click('#choose-right');
    await shot('study-done');
    rmSync(folder, { recursive: true });
  },
};
/** Options of servers that a journey needs for itself. */
const SERVERS = {
  gone: [],
  busy: ['--rate-limit', '2', '--rate-burst', '2'],
  key: ['--api-key', 'open-sesame'],
};

const parts = process.argv.slice(2);
const kinds = Object.keys(KINDS).filter((kind) => kind.includes(process.env.SCREENS ?? ''));
const names = Object.keys(JOURNEYS).filter(
  (name) => parts.length === 0 || parts.some((part) => name.includes(part)),
);
mkdirSync(OUT, { recursive: true });
const [shared, browser] = await Promise.all([startServer(), startBrowser()]);
let failed = 0;
for (const name of names) {
  for (const kind of kinds) {
    const server = SERVERS[name] ? await startServer(...SERVERS[name]) : shared;
    const { address } = server;
    const { page, problems } = await openPage(browser, address, KINDS[kind]);
    const context = page.context();
    const shot = async (state, { audit = false, full = false } = {}) => {
      const file = (rest) => join(OUT, `${state}-${kind}${rest}.png`);
      await page.screenshot({ path: file('') });
      if (full && kind.startsWith('phone'))
        await page.screenshot({ path: file('-full'), fullPage: true });
      if (!audit) return;
      await page.evaluate(axe);
      const { violations } = await page.evaluate(() => window.axe.run());
      for (const { id, nodes } of violations)
        console.log(`axe, ${state} ${kind}: ${id}: ${nodes.map(({ html }) => html).join(' ')}`);
    };
    try {
      await JOURNEYS[name](page, shot, { address, context, server });
    } catch (error) {
      failed++;
      await shot(`${name}-FAILED`);
      console.log(`${name} ${kind}: ${error.message}`);
    }
    for (const problem of new Set(problems)) console.log(`${name} ${kind}: ${problem}`);
    await context.close();
    if (server !== shared) server.stop();
  }
  console.log(`${name}: done`);
}
await browser.close();
shared.stop();
process.exitCode = failed > 0 ? 1 : 0;
