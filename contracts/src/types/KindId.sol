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
