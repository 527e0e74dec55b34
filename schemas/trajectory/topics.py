"""The file of several rollouts for a viewer: a topic for each, whose messages have all columns; no evidence."""

from collections.abc import Mapping
from operator import itemgetter

from ..ids import RolloutId
from .canonical import Layout, evidence_of
from .channels import state_channel
from .chunks import channel_record, chunked, seen_file, type_record
from .trajectory import Trajectory

OF_VIEWER = Layout("rollouts", ())


def topic_of(rollout: RolloutId) -> str:
    """Return the topic of a rollout: with slashes, since Foxglove reads a point as the begin of a field.

    >>> topic_of(RolloutId("robustness", 12, "true", 0))
    '/robustness/12/true/0'
    """
    return f"/{rollout.problem}/{rollout.test}/{rollout.variant}/{rollout.replicate}"


def encode_topics(
    shown: Mapping[RolloutId, Trajectory], *, units: Mapping[str, str], metadata: Mapping[str, str]
) -> bytes:
    """Return a file with every sample of trajectories of the same columns; `units` names the unit of each column.

    All begin at their own times, so that a viewer draws them over one another.
    """
    definitions: list[bytes] = []
    messages: list[tuple[int, int, bytes]] = []
    for number, (rollout, trajectory) in enumerate(shown.items(), start=1):
        named = {name: units[name] for name in trajectory.columns}
        channel = state_channel(topic_of(rollout), trajectory.samples[:, 0], trajectory.samples, named)
        if not definitions:
            definitions.append(type_record(1, channel.kind.full_name, "protobuf", channel.definition))
        definitions.append(channel_record(number, 1, channel.topic, "protobuf", channel.metadata))
        messages += ((time, number, data) for time, data in channel.messages)
    messages.sort(key=itemgetter(0, 1))  # stable: the two rows of a jump keep their order
    return seen_file(*evidence_of(OF_VIEWER, metadata, {}), definitions, chunked(definitions, messages))
