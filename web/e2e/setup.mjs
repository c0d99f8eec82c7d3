// A server and a browser for the tests.
//
// BAILANDO: the server's binary, or the address of one that runs; default target/debug/bailando.
// PAGE=dist: the page as it lies in web/dist, not as the binary has it.
// CHROMIUM: the browser; default: the first of chromium, chromium-browser, google-chrome.
import assert from 'node:assert/strict';
import { spawn, spawnSync } from 'node:child_process';
import { readdirSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { chromium } from 'playwright-core';

export const project = join(import.meta.dirname, '../..');

/** The server's binary or address, and the model. */
export const settings = () => ({
  binary: process.env.BAILANDO ?? join(project, 'target/debug/bailando'),
  model: process.env.BAILANDO_MODEL_DIR ?? join(project, 'models/default'),
});

/** Starts a server on a free port; `address` is where it answers. */
export async function startServer(...more) {
  const { binary, model } = settings();
  if (/^https?:/.test(binary)) return { address: binary.replace(/\/*$/, '/'), stop() {} };
  const args = ['serve', '--port', '0', '--json-output', '--model-dir', model, ...more];
  const child = spawn(binary, args, { cwd: project, stdio: ['ignore', 'pipe', 'pipe'] });
  const address = await new Promise((resolve, reject) => {
    let log = '';
    const read = (data) => {
      log += data;
      const found = /"address":"([^"]+)"/.exec(log);
      if (found) resolve(`http://${found[1]}/`);
    };
    child.stdout.on('data', read);
    child.stderr.on('data', read);
    child.on('exit', (code) => reject(new Error(`the server ended with ${code}: ${log}`)));
    child.on('error', reject);
  });
  return { address, stop: (signal) => child.kill(signal) };
}

export async function startBrowser() {
  const names = [process.env.CHROMIUM, 'chromium', 'chromium-browser', 'google-chrome'];
  const found = names.filter(Boolean).find((name) => spawnSync(name, ['--version']).status === 0);
  if (!found) throw new Error('no chromium: install it (Debian: apt-get install chromium)');
  const path = spawnSync('sh', ['-c', `command -v "${found}"`])
    .stdout.toString()
    .trim();
  return chromium.launch({
    executablePath: path,
    args: [
      // As browsers do without a graphics card: the scene is drawn by SwiftShader, the page not.
      '--use-angle=swiftshader',
      '--enable-unsafe-swiftshader',
      '--disable-gpu-compositing',
      '--autoplay-policy=no-user-gesture-required',
      '--use-fake-device-for-media-stream',
      '--use-fake-ui-for-media-stream',
      // Chromium does not sandbox itself as root.
      ...(process.getuid?.() === 0 ? ['--no-sandbox'] : []),
    ],
  });
}

const ofPage = ({ pathname }) => pathname === '/' || pathname.startsWith('/viewer/');
// Read at once: a build meanwhile does not mix with what is tested.
const dist = new Map();
if (process.env.PAGE === 'dist') {
  const folder = join(project, 'web/dist');
  for (const name of [
    'index.html',
    ...readdirSync(join(folder, 'viewer')).map((n) => `viewer/${n}`),
  ])
    dist.set(name, readFileSync(join(folder, name)));
}
/** Answers with a file of web/dist under the headers, and so the policy, of the server. */
async function fromDist(route) {
  const { pathname } = new URL(route.request().url());
  const body = dist.get(pathname === '/' ? 'index.html' : pathname.slice(1));
  await route.fulfill({ response: await route.fetch(), body });
}

/** Opens the page and waits until the figure stands; `problems` are errors and foreign requests. */
export async function openPage(browser, address, options = {}) {
  const context = await browser.newContext({ viewport: { width: 640, height: 480 }, ...options });
  if (process.env.PAGE === 'dist') await context.route(ofPage, fromDist);
  const page = await context.newPage();
  page.setDefaultTimeout(180_000);
  const problems = [];
  page.on('pageerror', (error) => problems.push(`error: ${error.message}`));
  page.on('console', (message) => {
    const { url } = message.location();
    const text = `${message.type()}: ${message.text()} ${url}`;
    // The browser logs every answer that is not a success, even those that the page shows.
    const shown = /Failed to load resource.*status of 4/.test(text) && /\/generate/.test(url);
    // Without a graphics card the browser reads each picture back, and notes that.
    const read = /GL Driver Message .*ReadPixels/.test(text);
    if (['error', 'warning'].includes(message.type()) && !shown && !read) problems.push(text);
  });
  page.on('request', (request) => {
    const url = request.url();
    if (!url.startsWith(address) && !/^(blob|data):/.test(url)) problems.push(`foreign: ${url}`);
  });
  await page.goto(address);
  await page.waitForFunction(() => window.bailando?.cast.members.length > 0);
  return { page, problems };
}

/** Waits until frames of every dancer are there. */
export const danced = (page) => page.waitForFunction(() => window.bailando.player.available > 0);

/** Waits until the dance is complete. */
export const complete = (page) =>
  page.waitForFunction(() => document.body.dataset.state === 'ready' && !window.bailando.running);

/** Sets the length of the next dance in seconds. */
export const setLength = (page, seconds) => page.fill('#length', String(seconds));

export const upload = (page, name, buffer) =>
  page.setInputFiles('#file', { name, mimeType: 'application/octet-stream', buffer });
/** Where a dancer's left wrist is. */
export const wrist = (page, member = 0) =>
  page.evaluate((i) => {
    const { figure } = window.bailando.cast.members[i];
    return figure.joint('l_wrist', figure.object.position.clone()).toArray();
  }, member);
/** Waits until what was asked for has been drawn. */
export const drawn = (page) =>
  page.evaluate(async () => {
    window.bailando.stage.invalidate();
    for (let i = 0; i < 3; i++) await new Promise(requestAnimationFrame);
  });
export const pause = (page) => page.evaluate(() => window.bailando.player.pause());

/** A server and a browser for the tests of a file. */
export function pages() {
  const running = { server: null, browser: null };
  before(async () => {
    [running.server, running.browser] = await Promise.all([startServer(), startBrowser()]);
  });
  after(async () => {
    await running.browser?.close();
    running.server?.stop();
  });
  /** Runs `body` on a fresh page and checks that the browser had nothing to complain about. */
  const onPage = (name, options, body) =>
    test(name, async (context) => {
      const { page, problems } = await openPage(running.browser, running.server.address, options);
      try {
        await body(page, context);
        assert.deepEqual(problems, []);
      } finally {
        await page.context().close();
      }
    });
  return { onPage, running };
}
