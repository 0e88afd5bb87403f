"""Notifications of a Prefect server: a webhook is called when a run of ours fails, and runs whose machine was lost are found.

The webhook's address is a secret. It comes from an environment variable, since arguments of commands can be read by everybody
on the machine, and is kept in a block of the server, encrypted; nothing prints it.
"""

from __future__ import annotations

import os
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from flows.server.deployments import TAG, Item, link
from schemas.errors import InputError

if TYPE_CHECKING:
    from prefect.client.orchestration import SyncPrefectClient

BLOCK = "metascenes-notification"
FAILURES = "metascenes-failures"
LOST = "metascenes-lost-runs"

MISSED_SECONDS = 600
"""Runs send a heartbeat every 3 minutes; after three that did not come the run is taken for lost."""

PAYLOAD = """{
  "text": {{ ("metascenes: " ~ flow.name ~ " '" ~ flow_run.name ~ "' ended as " ~ flow_run.state.name ~ ": "
             ~ (flow_run.state.message or "no message") ~ " PAGE" ~ flow_run.id) | tojson }}
}"""
"""What is sent: the form of Slack's incoming webhooks, which others read as well. PAGE is where the UI shows runs: a server
does not know by itself how people reach it."""

ENDS = ("Failed", "Crashed", "TimedOut")

AS_BEFORE = "as before: "
"""First words of the message of a failed run without news. The webhook is not called for such a run."""

ONCE_SECONDS = 60
"""An end of the same run within so long is the same end. A server hands an event to all its automations again when one of
them found the database locked, and a client tells a state again that it had no answer to: each called the webhook anew."""


def notify(environment_name: str) -> list[Item]:
    """Call the webhook that an environment variable names whenever a run with our tag fails.

    Raises:
        InputError: the variable is not set, or holds no http address.
    """
    from prefect.blocks.webhook import Webhook
    from prefect.client.orchestration import get_client
    from prefect.events.actions import CallWebhook
    from prefect.events.schemas.automations import AutomationCore, EventTrigger, Posture
    from pydantic import SecretStr

    url = os.environ.get(environment_name, "").strip()
    if not url.startswith(("http://", "https://")):
        raise InputError(
            environment_name, "", "holds no http address", "set it to the webhook's, as in https://hooks.slack.com/services/..."
        )
    before = _webhook()
    if before is None or before.url.get_secret_value() != url:
        Webhook(url=SecretStr(url), method="POST").save(BLOCK, overwrite=True)
    block = _webhook()
    assert block is not None
    block_id = block._block_document_id
    change = "created" if before is None else "unchanged" if before.url.get_secret_value() == url else "changed"
    wanted = AutomationCore(
        name=FAILURES,
        description="Calls the webhook of the block metascenes-notification when a run fails, crashes or takes too long.",
        trigger=EventTrigger(
            match={"prefect.resource.id": "prefect.flow-run.*", "prefect.state-message": f"!{AS_BEFORE}*"},
            match_related={"prefect.resource.id": f"prefect.tag.{TAG}", "prefect.resource.role": "tag"},
            expect={f"prefect.flow-run.{end}" for end in ENDS},
            for_each={"prefect.resource.id"},
            posture=Posture.Reactive,
            within=timedelta(seconds=ONCE_SECONDS),
        ),
        actions=[CallWebhook(block_document_id=block_id, payload=PAYLOAD.replace("PAGE", link("runs/flow-run/")))],
        tags=[TAG],
    )
    with get_client(sync_client=True) as client:
        return [Item("webhook", BLOCK, change, link(f"blocks/block/{block_id}")), _automation(client, wanted)]


def silence() -> list[Item]:
    """Remove what `notify` made."""
    from prefect.blocks.webhook import Webhook
    from prefect.client.orchestration import get_client

    items = []
    with get_client(sync_client=True) as client:
        for automation in client.read_automations_by_name(FAILURES):
            client.delete_automation(automation.id)
            items.append(Item("automation", FAILURES, "removed"))
    if _webhook() is not None:
        Webhook.delete(BLOCK)
        items.append(Item("webhook", BLOCK, "removed"))
    return items


def find_lost_runs(seconds: float = MISSED_SECONDS) -> Item:
    """Have the server call runs crashed that sent no sign of life for so long: their machine or its network is gone.

    Otherwise such a run would be running for ever, and nobody be told.
    """
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.objects import StateType
    from prefect.events.actions import ChangeFlowRunState
    from prefect.events.schemas.automations import AutomationCore, EventTrigger, Posture

    ends = ("Completed", "Failed", "Cancelled", "Crashed", "TimedOut")
    wanted = AutomationCore(
        name=LOST,
        description=f"A run whose process or machine is gone is called crashed, {seconds:g} seconds after its last sign of life.",
        trigger=EventTrigger(
            match={"prefect.resource.id": "prefect.flow-run.*"},
            match_related={"prefect.resource.id": f"prefect.tag.{TAG}", "prefect.resource.role": "tag"},
            after={"prefect.flow-run.heartbeat"},
            expect={"prefect.flow-run.heartbeat", *(f"prefect.flow-run.{end}" for end in ends)},
            for_each={"prefect.resource.id"},
            posture=Posture.Proactive,
            threshold=1,
            within=timedelta(seconds=seconds),
        ),
        actions=[
            ChangeFlowRunState(
                name=None, force=False, state=StateType.CRASHED, message="no sign of life: its process or machine is gone; run it again"
            )
        ],
        tags=[TAG],
    )
    with get_client(sync_client=True) as client:
        return _automation(client, wanted)


def _webhook() -> Any:
    """The block, with its secret; None where there is none."""
    from prefect.blocks.webhook import Webhook

    try:
        return Webhook.load(BLOCK)
    except ValueError:
        return None


def _automation(client: SyncPrefectClient, wanted: Any) -> Item:
    """One automation of that name, as it is wanted."""
    present = client.read_automations_by_name(wanted.name)
    for more in present[1:]:
        client.delete_automation(more.id)
    if not present:
        made = client.create_automation(wanted)
        return Item("automation", wanted.name, "created", link(f"automations/automation/{made}"))
    page = link(f"automations/automation/{present[0].id}")
    if _facts(present[0]) == _facts(wanted):
        return Item("automation", wanted.name, "unchanged", page)
    client.update_automation(present[0].id, wanted)
    return Item("automation", wanted.name, "changed", page)


def _facts(automation: Any) -> dict[str, Any]:
    """What a person set, without ids that the server adds."""
    facts: dict[str, Any] = automation.model_dump(mode="json", include={"name", "description", "trigger", "actions", "tags", "enabled"})
    facts["trigger"] = {
        name: sorted(value) if isinstance(value, list) else value for name, value in facts["trigger"].items() if name != "id"
    }
    return facts
