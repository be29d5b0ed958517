"""The outside world of a fault row in real time, with its trouble in it: `python -m sitl.fly_outside ORDER.json`."""

from __future__ import annotations

import json
import pickle
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from sitl.faults.arena import arena
from sitl.faults.evidence import Evidence
from sitl.faults.meddler import Meddler
from sitl.faults.roster import Roster
from sitl.faults.table import ROWS
from sitl.faults.trouble import Trouble
from sitl.fly_evidence import evidence_of
from sitl.fly_world import WorldOptions, make_world, run
from sitl.transport import UdpPeer
from uav_recon import config as product_config
from uav_recon.clock import RateKeeper

LONGEST_WAIT_S = 300.0  # for the trouble's moment: the product compiles first
TURN_S = 1.0 / 60.0  # of the ledger and of the troubles


@dataclass(frozen=True)
class Order:
    """world: a file of WorldOptions. row, number: whose trouble, and which of its cases. config: of the product."""

    world: str
    row: str
    number: int
    config: str

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")


def fly(order: Order) -> Evidence:
    """Run until there is nothing left to see. Raises OSError if the link's port cannot be had."""
    options, row = WorldOptions.load(Path(order.world)), ROWS[order.row]
    assert row.live is not None
    trouble = Trouble(row.id, row.live(order.number), row.onset, row.longest_s)
    meddler = Meddler([trouble], order.number, LONGEST_WAIT_S)
    peer = UdpPeer(remote=("127.0.0.1", options.port))
    world = make_world(options, arena(row.arena, options.radius_m), meddler.far_link(peer), time.monotonic)
    meddler.enter(world, None, time.monotonic())
    meddler.theatre.config, meddler.theatre.roster = Path(order.config), Roster(Path(options.stream).parent)
    turns = RateKeeper(1.0 / TURN_S, time.monotonic())

    def ended(now_s: float) -> bool:
        if turns.due(now_s):
            meddler.turn(now_s)
        return meddler.over(finished=False)

    run(world, ended)
    world.truth_log.save(Path(options.truth), world)
    peer.close()
    return evidence_of(meddler, product_config.load(Path(order.config)), Path(options.truth), options.radius_m)


def main(order: Path) -> None:
    """Fly as ordered; the evidence is left beside the order."""
    evidence = fly(Order(**json.loads(order.read_text(encoding="utf-8"))))
    fresh = order.with_suffix(".new")
    fresh.write_bytes(pickle.dumps(evidence))
    fresh.replace(order.with_suffix(".evidence"))


if __name__ == "__main__":
    sys.setswitchinterval(0.001)
    main(Path(sys.argv[1]))
