"""What a policy needs on a real robot (DB617)."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.analysis.deployment import Deployment, reading_key
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.lint.context import RuleContext


def reading_not_supplied(context: RuleContext) -> Iterator[Finding]:
    """DB617: the policy needs a reading of the world that no robot measures, and `deploy` does not say what supplies it.

    In the simulation, the supervisor reads the world: `position(ball)` is exact and never late. A robot has its sensors only. A scenario
    with a section `deploy` is meant for a robot, so each such reading needs something that supplies it: a tracker, an estimator, another
    robot. Write it under `deploy.supplied_by`, or observe a sensor instead. The rule also reports an entry of `supplied_by` that the
    policy does not need. Scenarios without `deploy` are not checked.

    Example::

        deploy: {supplied_by: {position(cart): cameras}}

    Instead::

        deploy: {supplied_by: {position(cart): cameras, velocity(cart): cameras, velocity(cart.tip): cameras}}
    """
    spec = context.checked.spec
    if spec is None or spec.deploy is None:
        return
    deployment = Deployment(context.program)
    given = {reading_key(key): key for key in spec.deploy.supplied_by}
    missing = [name for name in deployment.unmeasured if name not in given]
    if missing:
        needed = f"{', '.join(f'`{name}`' for name in missing)}, which no robot measures"
        help = f"write what supplies it, as in `deploy: {{supplied_by: {{{missing[0]}: motion capture}}}}`, or observe a sensor instead"
        yield Finding("DB617", context.values.key_span(("deploy",)), f"the policy needs {needed}, and `deploy` names no supplier", help)
    known = [*deployment.unmeasured, *deployment.goals]
    for name, key in given.items():
        if name not in known:
            near = nearest_word(name, known)
            help = f"did you mean `{near}`?" if near else "remove it" if not known else f"the policy needs {', '.join(known)}"
            span = context.values.key_span(("deploy", "supplied_by", key))
            yield Finding("DB617", span, f"the policy does not need `{name}`", help)


STATIC_RULES = (reading_not_supplied,)
