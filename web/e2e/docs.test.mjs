// "Try it out" at /docs in a real browser: the first click works, whatever is sent.
import { after, before, test } from 'node:test';
import assert from 'node:assert/strict';
import { clicks } from './files.mjs';
import { startBrowser, startServer } from './setup.mjs';

// Milliseconds that the page may stand still; without our start script it is minutes.
const LONGEST_TASK = 10_000;
const song = { name: 'song.wav', mimeType: 'audio/wav', buffer: clicks(30) };

let server, browser;
before(async () => {
  server = await startServer();
  browser = await startBrowser();
});
after(async () => {
  await browser?.close();
  server?.stop();
});

/** Opens `POST /generate` with its fields; `execute` sends them and waits for the answer. */
async function tryIt() {
  const page = await browser.newPage();
  page.setDefaultTimeout(120_000);
  await page.addInitScript(() => {
    window.longest = 0;
    new PerformanceObserver((list) => {
      for (const { duration } of list.getEntries())
        window.longest = Math.max(window.longest, duration);
    }).observe({ entryTypes: ['longtask'] });
  });
  await page.goto(new URL('docs/', server.address).href);
  const operation = page.locator('#operations-dance-generate_motion');
  await operation.locator('.opblock-summary-control').click();
  await operation.locator('.try-out__btn').click();
  const body = operation.locator('.opblock-section-request-body');
  const types = {
    sent: body.locator('select').first(),
    wanted: operation.locator('.responses-table select').first(),
  };
  const execute = async () => {
    // The song comes first; the form has a field for a character too.
    await body.locator('input[type=file]').first().setInputFiles(song);
    const answered = page.waitForResponse((response) => response.url().includes('/generate'));
    await operation.locator('.execute').click();
    const response = await answered;
    await operation.locator('.live-responses-table .response .response-col_status').waitFor();
    return { response, text: await operation.locator('.live-responses-table').innerText() };
  };
  return { page, body, types, execute };
}

test('the form comes first, without invented values, and gives BVH', async () => {
  const { page, body, types, execute } = await tryIt();
  assert.equal(await types.sent.inputValue(), 'multipart/form-data');
  assert.equal(await types.wanted.inputValue(), 'application/x-bvh');
  const filled = await body
    .locator('tr[data-property-name]')
    .evaluateAll((rows) =>
      rows
        .flatMap((row) => [...row.querySelectorAll('select, textarea, input:not([type=file])')])
        .filter((field) => field.value !== ''),
    );
  assert.equal(filled.length, 0);
  const { response, text } = await execute();
  assert.equal(response.status(), 200);
  assert.match(text, /Download file/);
  await page.close();
});

test('the song as the body works as well', async () => {
  const { page, types, execute } = await tryIt();
  await types.sent.selectOption('application/octet-stream');
  const { response } = await execute();
  assert.equal(response.status(), 200);
  await page.close();
});

test('the JSON of 30 s does not freeze the page', async () => {
  const { page, types, execute } = await tryIt();
  await types.wanted.selectOption('application/json');
  const { response, text } = await execute();
  assert.equal(response.status(), 200);
  assert.match(text, /Download file \(1,\d+,\d+ characters\)/);
  const longest = await page.evaluate(() => window.longest);
  assert.ok(longest < LONGEST_TASK, `${longest} ms`);
  await page.close();
});
