# dask.distributed: the scheduler in agent 1, a worker in agent 2, a client in agent 3.
import asyncio, logging, sys
import dask, distributed
dask.config.set({"distributed.worker.daemon": False, "distributed.admin.tick.interval": "1s", "distributed.worker.memory.spill": False, "distributed.worker.profile.enabled": False})
me = int(sys.argv[1]); logging.disable()
def square(x): return x * x

async def main():
    if me == 1:
        async with distributed.Scheduler(host="10.0.0.1", port=8786, dashboard=False): await asyncio.sleep(6.5)
    elif me == 2:
        await asyncio.sleep(2)
        async with distributed.Worker("tcp://10.0.0.1:8786", host="10.0.0.2", nthreads=2, dashboard=False): await asyncio.sleep(4)
    else:
        await asyncio.sleep(3.5)
        async with distributed.Client("tcp://10.0.0.1:8786", asynchronous=True) as c:
            await c.wait_for_workers(1, timeout=2); print(await c.gather(c.map(square, range(5)))); print(await c.submit(sum, c.map(square, range(10))))
    print("done")

if __name__ == "__main__": asyncio.run(main())
