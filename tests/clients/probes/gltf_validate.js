// node gltf_validate.js NODE_MODULES FILE.glb: prints what Khronos' validator finds, as JSON.
const fs = require("fs");
const [modules, file] = process.argv.slice(2);
const validator = require(`${modules}/gltf-validator`);
validator.validateBytes(new Uint8Array(fs.readFileSync(file))).then((report) => {
  console.log(JSON.stringify(report.issues));
});
