"""Everything that crosses the wire: keys, messages, their byte layout, and who may send what."""
