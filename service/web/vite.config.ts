import { defineConfig } from "vite";

export default defineConfig({
  base: "./", // the page works behind any path prefix
  build: {
    outDir: "../unbend/api/page",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0, // the content policy allows no data: URLs
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 700,
  },
  server: { proxy: { "/v1": "http://127.0.0.1:8000" } },
});
