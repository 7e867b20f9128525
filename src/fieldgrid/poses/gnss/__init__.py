"""Bytes of receivers to fixes: NMEA 0183 with the sentences of makers, and UBX."""
