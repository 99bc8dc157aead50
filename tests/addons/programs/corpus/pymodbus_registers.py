# pymodbus: registers of a device in agent 1 by Modbus/TCP, read and written by agent 2.
import asyncio, sys
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.server import StartAsyncTcpServer, ServerAsyncStop
from pymodbus.datastore import ModbusSequentialDataBlock, ModbusDeviceContext, ModbusServerContext
me = int(sys.argv[1])

async def main():
    if me == 1:
        device = ModbusDeviceContext(hr=ModbusSequentialDataBlock(1, list(range(100, 120))))
        task = asyncio.create_task(StartAsyncTcpServer(ModbusServerContext(devices=device, single=True), address=("10.0.0.1", 5020)))
        await asyncio.sleep(6); await ServerAsyncStop(); print("stopped"); return
    await asyncio.sleep(1.5)
    async with AsyncModbusTcpClient("10.0.0.1", port=5020, timeout=1) as c:
        print((await c.read_holding_registers(0, count=5)).registers); await c.write_register(2, 7)
        await asyncio.sleep(1); print((await c.read_holding_registers(0, count=5)).registers)

asyncio.run(main())
