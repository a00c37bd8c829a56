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

/// @dev No address is as long.
uint256 constant FOR_PROVEN = 1 << 200;

/// @notice The number of the queue of a kind's tasks that name nobody.
/// @param proven of those that only proven providers are offered
function queueOf(KindId kindId, bool proven) pure returns (uint256) {
    return KindId.unwrap(kindId) | (proven ? FOR_PROVEN : 0);
}
