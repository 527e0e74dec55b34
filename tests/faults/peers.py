"""Peers on the network that belong to nobody."""

import json
import signal

from perfbound.schemas.link.configuration import USER
from perfbound.schemas.link.seal import link_password
from perfbound.schemas.link.secret import VARIABLE
from tests.end_to_end.processes import query, wait_for
from tests.faults.memory import memory
from tests.faults.scene import Scene

MOST_MEMORY = 400 * 2**20
"""Bytes of an orchestrator beside a hostile peer, whatever it sends; its libraries take 173 MB of them."""
STRANGE = """
    SELECT rollout, worker FROM attempts WHERE worker LIKE 'forged%' UNION
    SELECT rollout, outcome FROM outcomes WHERE outcome NOT IN ('recorded', 'restored') OR worker LIKE 'forged%'
"""


def hostile_peer(scene: Scene) -> None:
    """A process without the secret forges, repeats and floods messages of everybody: nothing of it is recorded.

    It has the password of the link, or not even that.
    """
    secret = f"{scene.chance.getrandbits(256):064x}"
    alone, scene.environment = dict(scene.environment), scene.environment | {VARIABLE: secret}
    scene.remote = True
    scene.start(workers=0)
    wait_for(lambda: query(scene.directory, "SELECT run FROM campaign"))
    inside = scene.chance.random() < 0.8
    link = {"user": USER, "password": link_password(secret.encode())}
    peer = scene.processes.start(
        *("python", "-m", "tests.faults.hostile", scene.listening, scene.directory, "--other", scene.subject.calm),
        *("--seed", str(scene.chance.randrange(2**31)), *(("--link", json.dumps(link)) if inside else ())),
        **alone,
    )
    scene.join()
    scene.join()
    with memory(scene) as used:
        if scene.chance.random() < 0.5 and scene.reach(scene.moments(1)[0]):
            scene.join()  # which orchestrator is its own?
        scene.finish()
    assert all(each.running for each in scene.fleet), "a worker has ended"
    peer.popen.send_signal(signal.SIGTERM)
    count = int(peer.wait().out)
    scene.did(f"{count} messages of a peer {'with' if inside else 'without'} the password of the link")
    scene.did(f"the orchestrator took {used() >> 20} MB", fault=False)
    scene.injected += count - 1
    assert used() < MOST_MEMORY
    strange = query(scene.directory, STRANGE)
    assert not strange, f"of the peer: {strange[:5]}"
