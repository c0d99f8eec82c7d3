// A server and a browser for the tests.
//
// BAILANDO: the server's binary, or the address of one that runs; default target/debug/bailando.
// CHROMIUM: the browser; default: the first of chromium, chromium-browser, google-chrome.
import { spawn, spawnSync } from 'node:child_process';
import { join } from 'node:path';
import { chromium } from 'playwright-core';

const project = join(import.meta.dirname, '../..');

/** Starts a server on a free port; `address` is where it answers. */
export async function startServer(...settings) {
  const binary = process.env.BAILANDO ?? join(project, 'target/debug/bailando');
  if (/^https?:/.test(binary)) return { address: binary.replace(/\/*$/, '/'), stop() {} };
  const model = process.env.BAILANDO_MODEL_DIR ?? join(project, 'models/default');
  const args = ['serve', '--port', '0', '--json-output', '--model-dir', model, ...settings];
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
  return { address, stop: () => child.kill() };
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
      // Software rendering, for machines without a graphics card.
      '--use-angle=swiftshader',
      '--enable-unsafe-swiftshader',
      '--ignore-gpu-blocklist',
      '--autoplay-policy=no-user-gesture-required',
      '--use-fake-device-for-media-stream',
      '--use-fake-ui-for-media-stream',
      // Chromium does not sandbox itself as root.
      ...(process.getuid?.() === 0 ? ['--no-sandbox'] : []),
    ],
  });
}

/** Opens the page and waits until the figure stands; `problems` are errors and foreign requests. */
export async function openPage(browser, address, options = {}) {
  const context = await browser.newContext({ viewport: { width: 640, height: 480 }, ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(180_000);
  const problems = [];
  page.on('pageerror', (error) => problems.push(`error: ${error.message}`));
  page.on('console', (message) => {
    const { url } = message.location();
    const text = `${message.type()}: ${message.text()} ${url}`;
    // The browser logs every answer that is not a success, even those that the page shows.
    const shown = /Failed to load resource.*status of 4/.test(text) && /\/generate/.test(url);
    if (['error', 'warning'].includes(message.type()) && !shown) problems.push(text);
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
