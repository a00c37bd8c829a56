// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice The number that an organization gives a kind of work, counted from 1. See IOrganization.numberOf.
type KindId is uint8;

/// @dev No kind has this number.
KindId constant NO_KIND = KindId.wrap(0);

using {equal as ==, differ as !=} for KindId global;

function equal(KindId a, KindId b) pure returns (bool) {
    return KindId.unwrap(a) == KindId.unwrap(b);
}

function differ(KindId a, KindId b) pure returns (bool) {
    return KindId.unwrap(a) != KindId.unwrap(b);
}

/// @notice The number of a queue of open tasks. No provider's address is as small as a service's number, because whoever has
/// services has signed for them, and none reaches the last bit.
/// @param named the service, or the provider as a number, that the tasks name; 0 for those that name nobody
/// @param proven of those that only proven providers are offered
function queueOf(KindId kindId, uint160 named, bool proven) pure returns (uint256) {
    return uint256(named) << 8 | KindId.unwrap(kindId) | (proven ? 1 << 255 : 0);
}
