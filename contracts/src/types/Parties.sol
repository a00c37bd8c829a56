// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice Who beside its creator is a party to a task, in one word, for the reason that Submission has.
/// From the lowest bit on: provider (160 bits), others (1).
type Parties is uint256;

uint256 constant OTHERS = 160;

/// @dev Nobody has looked them up.
Parties constant NO_PARTIES = Parties.wrap(0);

using {equal as ==, provider, others} for Parties global;

/// @param by who offers the service that does the task
/// @param also whether others may be parties
function packParties(address by, bool also) pure returns (Parties) {
    return Parties.wrap((also ? 1 << OTHERS : 0) | uint160(by));
}

function equal(Parties a, Parties b) pure returns (bool) {
    return Parties.unwrap(a) == Parties.unwrap(b);
}

/// @notice Who offers the service that does the task.
function provider(Parties parties) pure returns (address) {
    return address(uint160(Parties.unwrap(parties)));
}

/// @notice Whether others than creator and provider may be parties, see IServiceManager.isParty.
function others(Parties parties) pure returns (bool) {
    return Parties.unwrap(parties) >> OTHERS != 0;
}
