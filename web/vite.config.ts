import { defineConfig } from 'vite';

// Names without hashes: the files are committed, and the server's ETags tell browsers what is new.
const name = 'viewer/[name][extname]';

export default defineConfig({
  // Relative addresses, so that the page also works under a path of a proxy.
  base: './',
  build: {
    target: 'es2022',
    sourcemap: false,
    // The policy of the page allows no inlined files but those that users bring.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1200,
    rolldownOptions: {
      output: {
        entryFileNames: 'viewer/[name].js',
        chunkFileNames: 'viewer/[name].js',
        assetFileNames: name,
      },
    },
  },
  server: {
    // `npm run dev` beside a running server.
    proxy: Object.fromEntries(
      ['/generate', '/info', '/codes', '/ready', '/docs', '/api-doc'].map((path) => [
        path,
        process.env.BAILANDO ?? 'http://127.0.0.1:8080',
      ]),
    ),
  },
});
