import { defineConfig } from "vite";

// Names without digests: the server knows the files that there are, and sends nothing else.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../src/inpaint3d/stages/mask_authoring/page/bundle",
    emptyOutDir: true,
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    rollupOptions: { output: { entryFileNames: "page.js", assetFileNames: "page[extname]" } },
  },
});
