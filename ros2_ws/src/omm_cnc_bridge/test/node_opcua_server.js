// An OPC UA server that is not asyncua's: node-opcua with the CNC nodeset (OPC 40502).
// node node_opcua_server.js PORT [MIN_SAMPLE_MS]; prints "ready", then moves X by 0.1 mm every 10 ms.
// By itself it reports a value every 50 ms at most; MIN_SAMPLE_MS 0 lets it report every change.
const { OPCUAServer, DataType, StatusCodes, standardUnits } = require("node-opcua");
const { nodesets } = require("node-opcua-nodesets");

const port = Number(process.argv[2]);
const fastest = process.argv[3];
const AXES = ["X", "Y", "Z"];

async function main() {
  const server = new OPCUAServer({
    port,
    host: "127.0.0.1",
    nodeset_filename: [nodesets.standard, nodesets.cnc],
    serverInfo: { applicationUri: "urn:omm:test" },
    ...(fastest === undefined ? {} : { serverCapabilities: { minSupportedSampleRate: Number(fastest) } }),
  });
  await server.initialize();
  const space = server.engine.addressSpace;
  const own = space.getOwnNamespace();
  const cnc = space.getNamespaceIndex("http://opcfoundation.org/UA/CNC");
  const make = (type, name, parent) =>
    space.findObjectType(type, cnc).instantiate({ browseName: { name, namespaceIndex: cnc }, componentOf: parent });
  const cncInterface = own.addObject({
    browseName: { name: "CncInterface", namespaceIndex: cnc },
    organizedBy: space.rootFolder.objects,
  });
  const list = own.addObject({ browseName: { name: "CncAxisList", namespaceIndex: cnc }, componentOf: cncInterface });
  const positions = {};
  for (const name of AXES) {
    const axis = make("CncAxisType", name, list);
    positions[name] = axis.posDirect;
    axis.posDirect.engineeringUnits.setValueFromSource({
      dataType: DataType.ExtensionObject,
      value: standardUnits.millimetre,
    });
    axis.actStatus.setValueFromSource({ dataType: DataType.Int32, value: 0 });
    axis.isReferenced.setValueFromSource({ dataType: DataType.Boolean, value: true });
  }
  await server.start();
  console.log("ready");
  let x = 0;
  setInterval(() => {
    x += 0.1;
    const now = new Date();
    for (const name of AXES) {
      const value = name === "X" ? x : 5;
      for (const item of ["actPos", "cmdPos"]) {
        positions[name][item].setValueFromSource({ dataType: DataType.Double, value }, StatusCodes.Good, now);
      }
    }
  }, 10);
}

main().catch((error) => {
  console.error(error);
  process.exit(1);
});
