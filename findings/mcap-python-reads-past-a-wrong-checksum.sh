#!/bin/sh
# One would expect that a reader of MCAP notices a message that was damaged after it was written: each chunk has a checksum.
# The Python reader compares checksums only if it is called with validate_crcs=True. By default it returns the damaged
# message without a word. Readers of other languages differ, so a file can be good for one program and damaged for another.
# Seen with mcap 1.6.0.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import io
import sys

import mcap
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError
from mcap.writer import CompressionType, Writer

print("mcap", mcap.__version__)
file = io.BytesIO()
writer = Writer(file, compression=CompressionType.NONE)
writer.start()
schema = writer.register_schema("number", "jsonschema", b"{}")
channel = writer.register_channel("/numbers", "json", schema)
for index in range(10):
    writer.add_message(channel, index * 10, b'{"value": %d000}' % index, index * 10)
writer.finish()
data = bytearray(file.getvalue())
data[data.index(b'"value": 5000') + 9] = ord("9")


def sixth(**options):
    try:
        return [message.data for _, _, message in make_reader(io.BytesIO(bytes(data)), **options).iter_messages()][5]
    except CRCValidationError as error:
        return error


plain, checked = sixth(), sixth(validate_crcs=True)
print("expected: an error. default:", plain, "validate_crcs=True:", type(checked).__name__, checked)
sys.exit(0 if plain == b'{"value": 9000}' and isinstance(checked, CRCValidationError) else "the behaviour has changed")
PYTHON
