"""Layout of a message's payload: fields of fixed length, then a body (section 4 of SPEC.md).

A missing tail of the fields reads as 0, and an unknown tail is ignored. A payload that is shorter
than the head of a message with a body is no message.
"""

from collections.abc import Callable
from struct import Struct
from typing import ClassVar, Self, cast


class Message:
    """Base class of the messages; the fields are those of the layout, then the body.

    Attributes
    ----------
    TYPE : int
        Type of the message, its id on the wire.
    CAN : int
        Class of the message on CAN, a `CanClass`.
    HEAD : Struct
        Layout of the fixed part.
    BODY : bool
        Whether a body of variable length follows.
    """

    __slots__ = ()
    __match_args__: ClassVar[tuple[str, ...]]
    TYPE: ClassVar[int]
    CAN: ClassVar[int]
    HEAD: ClassVar[Struct]
    BODY: ClassVar[bool] = False

    def pack(self) -> bytes:
        """Encode the message.

        Returns
        -------
        bytes
            Payload of a packet.
        """
        values = [getattr(self, name) for name in self.__match_args__]
        body: bytes = values.pop() if self.BODY else b""
        return self.HEAD.pack(*values) + body

    @classmethod
    def unpack(cls, payload: bytes) -> Self | None:
        """Decode a message.

        Parameters
        ----------
        payload : bytes
            Payload of a packet.

        Returns
        -------
        Message or None
            The message; None if the payload is shorter than the head of a message with a body.
        """
        size, make = cls.HEAD.size, cast("Callable[..., Self]", cls)
        if not cls.BODY:
            return make(*cls.HEAD.unpack(payload[:size].ljust(size, b"\0")))
        if len(payload) < size:
            return None
        return make(*cls.HEAD.unpack_from(payload), bytes(payload[size:]))
