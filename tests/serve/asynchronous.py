"""Reads a served map by asyncpg, and by SQLAlchemy on it: asynchronous.py POSTGRES"""

import asyncio
import sys

import asyncpg
import shapely
import sqlalchemy
from sqlalchemy.ext.asyncio import create_async_engine

LINES = "SELECT lane, geometry FROM lanes WHERE lane >= $1 ORDER BY lane"


async def pooled(pool):
    """What a program asks with a connection that it gives back, and that is told to forget then."""
    async with pool.acquire() as client:
        lanes = await client.fetch(LINES, 0)
        assert lanes
        # A type that asyncpg has to ask for: as text, as long as nobody says better.
        shapes = {shapely.from_wkb(lane["geometry"]).geom_type for lane in lanes}
        assert shapes == {"LineString"}, shapes
        async with client.transaction():
            try:
                async with client.transaction():
                    await client.fetch("SELECT nothing FROM lanes")
            except asyncpg.UndefinedColumnError:
                pass
            assert await client.fetchval("SELECT 1") == 1
        assert await client.fetchval("SELECT set_config('application_name', 'mine', false)") == "mine"
        try:
            await client.fetchval("SELECT set_config('search_path', 'v1', false)")
        except asyncpg.PostgresError as error:
            assert "v1.lanes" in str(error), error
        else:
            sys.exit("search_path is passed over")


async def typed(door):
    """Geometries by a codec that a program brings."""
    client = await asyncpg.connect(**door)
    await client.set_type_codec(
        "geometry", schema="pg_catalog", encoder=shapely.to_wkb, decoder=shapely.from_wkb, format="binary"
    )
    line = await client.fetchval("SELECT geometry FROM lanes ORDER BY lane LIMIT 1")
    assert line.geom_type == "LineString", line
    await client.close()


async def main(postgres):
    host, port = postgres.split(":")
    door = {"host": host, "port": int(port), "user": "me", "database": "map"}
    async with asyncpg.create_pool(**door, min_size=1, max_size=1) as pool:
        for _ in range(2):
            await pooled(pool)
    await typed(door)
    engine = create_async_engine(f"postgresql+asyncpg://me@{postgres}/map")
    async with engine.connect() as client:
        lanes = await client.execute(sqlalchemy.text("SELECT count(*) FROM lanes"))
        assert lanes.scalar_one() > 0
    await engine.dispose()


asyncio.run(main(*sys.argv[1:]))
