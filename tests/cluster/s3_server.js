// A local S3 server for s3_test.sh. usage: node s3_server.js MODULE_FOLDER PORT DIRECTORY [strict]
// Not strict: signatures of listings are accepted though the server computes others than GDAL; strict: only right ones are.
const [, , modules, port, directory, strict] = process.argv;
const S3rver = require(modules + '/@20minutes/s3rver');
new S3rver({
  address: '127.0.0.1',
  port: Number(port),
  directory,
  silent: true,
  allowMismatchedSignatures: strict !== 'strict',
  configureBuckets: [{ name: 'flights' }, { name: 'store' }],
}).run().then(() => console.log('ready'));
