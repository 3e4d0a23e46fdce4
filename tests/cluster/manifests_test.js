// Goal: the Kubernetes manifests have the types, required and known fields of the API, and agree with each other and with the programs.
// Method: npm kubernetes-models validates each document; every field is then replaced by something of a wrong type, which the validation has to
// refuse: a field that may hold anything is one that it does not know. The rest is compared here.
// usage: node manifests_test.js SOURCE_FOLDER MODULE_FOLDER
const fs = require('fs');
const [, , source, modules] = process.argv;
const yaml = require(modules + '/js-yaml');
const text = ['trem', 'sweep'].map((name) => fs.readFileSync(`${source}/deploy/kubernetes/${name}.yaml`, 'utf8')).join('\n---\n');
const failures = [];
const check = (holds, what) => { if (!holds) failures.push(what); };

function invalid(document) {
  const kinds = require(modules + '/kubernetes-models/' + document.apiVersion);
  if (!kinds[document.kind]) return `there is no ${document.kind} in ${document.apiVersion}`;
  try {
    new kinds[document.kind](document).validate();
  } catch (error) {
    return error.message;
  }
  return '';
}

// Paths of fields below `node`, a part of `document`, that the validation knows nothing of.
function unknownFields(document, node, path) {
  const unknown = [];
  for (const key of Object.keys(node)) {
    const here = Array.isArray(node) ? `${path}[${key}]` : `${path}.${key}`;
    const value = node[key];
    if (here !== '.apiVersion' && here !== '.kind') {
      node[key] = value !== null && typeof value === 'object' ? 'not this' : { not: { this: 1 } };
      if (!invalid(document)) unknown.push(here);
      node[key] = value;
    }
    if (value !== null && typeof value === 'object') unknown.push(...unknownFields(document, value, here));
  }
  return unknown;
}

const documents = yaml.loadAll(text);
for (const document of documents) {
  const name = `${document.kind} ${document.metadata.name}`;
  const error = invalid(document);
  check(!error, `${name}: ${error}`);
  if (!error) for (const field of unknownFields(document, document, '')) check(false, `${name}: unknown field ${field}`);
}
// The check itself: misspelt fields are found.
for (const [from, to] of [['replicas: 1', 'replica: 1'], ['readOnlyRootFilesystem', 'readonlyRootFilesystem'], ['periodSeconds: 20', 'periodSecond: 20'], ['concurrencyPolicy', 'concurrentPolicy']]) {
  check(text.includes(from), `the manifest has no ${from}`);
  const changed = yaml.loadAll(text.replace(from, to));
  check(changed.some((document) => !invalid(document) && unknownFields(document, document, '').length > 0), `${to} is not found out`);
}

const find = (kind, name) => documents.find((d) => d.kind === kind && d.metadata.name === name);
const service = find('Service', 'trem-coordinator');
const sweep = find('CronJob', 'trem-sweep').spec.jobTemplate.spec.template;
const podOf = { 'trem-coordinator': find('StatefulSet', 'trem-coordinator'), 'trem-worker': find('Deployment', 'trem-worker') };
// Runs as nobody in particular, with nothing writable but volumes that are there, and a key that is a secret.
function checkPod(name, pod, claims) {
  const container = pod.containers[0];
  check(pod.securityContext.runAsNonRoot && container.securityContext.readOnlyRootFilesystem, `${name}: not locked down`);
  check(container.securityContext.capabilities.drop.includes('ALL'), `${name}: keeps capabilities`);
  check(pod.automountServiceAccountToken === false, `${name}: has a token of the cluster`);
  const volumes = [...(pod.volumes || []).map((volume) => volume.name), ...claims];
  for (const mount of container.volumeMounts) check(volumes.includes(mount.name), `${name}: no volume ${mount.name}`);
  check(pod.volumes.some((volume) => volume.name === 'key' && volume.secret && volume.secret.defaultMode === 0o440), `${name}: its key is no secret`);
}
checkPod('trem-sweep', sweep.spec, []);
for (const [name, workload] of Object.entries(podOf)) {
  const spec = workload.spec;
  const pod = spec.template.spec;
  check(JSON.stringify(spec.selector.matchLabels) === JSON.stringify(spec.template.metadata.labels), `${name}: selector and labels differ`);
  checkPod(name, pod, (spec.volumeClaimTemplates || []).map((claim) => claim.metadata.name));
  const budget = find('PodDisruptionBudget', name);
  check(budget && JSON.stringify(budget.spec.selector) === JSON.stringify(spec.selector), `${name}: no PodDisruptionBudget for these pods`);
}
const coordinator = podOf['trem-coordinator'].spec.template.spec.containers[0];
for (const port of service.spec.ports) {
  check(coordinator.ports.some((p) => p.name === port.targetPort && p.containerPort === port.port), `no port ${port.name}`);
}
const http = fs.readFileSync(source + '/coordinator/app/monitoring.cc', 'utf8');
for (const probe of ['startupProbe', 'livenessProbe', 'readinessProbe']) {
  check(coordinator[probe] && http.includes(`"${coordinator[probe].httpGet.path}"`), `${probe}: the coordinator does not serve it`);
}
const dockerfile = fs.readFileSync(source + '/deploy/docker/Dockerfile', 'utf8');
for (const port of coordinator.ports) check(dockerfile.includes(String(port.containerPort)), `Dockerfile does not expose ${port.containerPort}`);
const worker = podOf['trem-worker'].spec.template.spec.containers[0];
const option = (name) => worker.args[worker.args.indexOf(name) + 1];
check(option('--coordinator') === `tcp://${service.metadata.name}:7411`, 'workers do not ask the service');
const serve = fs.readFileSync(source + '/worker/app/serve_command.cc', 'utf8');
for (const arg of worker.args.filter((a) => a.startsWith('--'))) check(serve.includes(`"${arg}"`), `trem-worker serve has no ${arg}`);
check(Number(option('--memory-max-bytes')) < parseInt(worker.resources.limits.memory, 10) * 2 ** 30, 'workers take tasks larger than their limit');
const version = fs.readFileSync(source + '/CMakeLists.txt', 'utf8').match(/project\(trem VERSION ([0-9.]+)/)[1];
const sweeper = sweep.spec.containers[0];
for (const container of [coordinator, worker, sweeper]) check(container.image.endsWith(`:${version}`), `${container.image} is not of version ${version}`);

// The sweep: a command of trem with options that it has, in an image that has both programs.
const cli = fs.readFileSync(source + '/coordinator/cli/app.cc', 'utf8');
check(sweeper.args[0] === 'sweep' && cli.includes('request, "sweep", '), 'trem has no command sweep');
for (const arg of sweeper.args.filter((a) => a.startsWith('--'))) check(cli.includes(`"${arg}"`), `trem sweep has no ${arg}`);
check(sweeper.args[sweeper.args.indexOf('--coordinator') + 1] === `tcp://${service.metadata.name}:7411`, 'the sweep does not ask the service');
check(sweeper.image === worker.image && dockerfile.slice(dockerfile.indexOf(' AS worker')).includes('/out/trem /out/trem-worker '), 'no image has both programs');
check(sweeper.volumeMounts.some((mount) => mount.mountPath === '/tmp'), 'the sweep has nowhere to write its list');
check(find('NetworkPolicy', 'trem-sweep').spec.podSelector.matchLabels.app === sweep.metadata.labels.app, 'the policy is about other pods');

// From the coordinator's metrics by the adapter's rule to the autoscaler.
const rule = yaml.load(fs.readFileSync(source + '/deploy/kubernetes/prometheus-adapter.yaml', 'utf8')).rules.external[0];
const metrics = fs.readFileSync(source + '/coordinator/app/metrics.cc', 'utf8');
for (const name of (rule.seriesQuery + rule.metricsQuery).match(/trem_\w+/g)) check(metrics.includes(`"${name}"`), `the coordinator has no metric ${name}`);
const scaler = find('HorizontalPodAutoscaler', 'trem-worker');
check(scaler.spec.metrics[0].external.metric.name === rule.name.as, 'the autoscaler asks for another metric than the adapter has');
check(scaler.spec.scaleTargetRef.name === podOf['trem-worker'].metadata.name, 'the autoscaler scales something else');
check(!/AKIA|secret_key|BEGIN/.test(text), 'a secret in the manifest');
for (const failure of failures) console.log('FAILED: ' + failure);
console.log(`${documents.length} documents, ${failures.length} failures`);
process.exit(failures.length === 0 ? 0 : 1);
