"""A message format."""

from deepbots_cli.message_formats import MessageFormat

PIPED = MessageFormat("Numbers as text, between bars.", "acme.runtime:piped")
