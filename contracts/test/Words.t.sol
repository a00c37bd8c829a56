// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {KindId} from "../src/types/KindId.sol";
import {NO_PARTIES, Parties, packParties} from "../src/types/Parties.sol";
import {ServiceId, unpackService} from "../src/types/ServiceId.sol";
import {Submission, packSubmission} from "../src/types/Submission.sol";
import {Fixture} from "./Fixture.sol";
import {Possession} from "./Possession.sol";

/// @notice What contracts tell each other in one word.
contract WordsTest is Test {
    function testFuzz_aSubmissionIsReadAsItWasWritten(
        address creator,
        uint32 service,
        uint8 kind,
        uint40 time
    ) public pure {
        Submission word = packSubmission(creator, unpackService(service), KindId.wrap(kind), time);
        assertEq(word.creator(), creator);
        assertEq(word.serviceId().pack(), service);
        assertEq(KindId.unwrap(word.kindId()), kind);
        assertEq(word.submitted(), time);
    }

    function testFuzz_partiesAreReadAsTheyWereWritten(address provider, bool others) public pure {
        Parties word = packParties(provider, others);
        assertEq(word.provider(), provider);
        assertEq(word.others(), others);
        assertEq(word == NO_PARTIES, provider == address(0) && !others);
    }
}

/// @notice Who is told the parties to a task.
contract PartiesTest is Fixture {
    /// @dev Of another judge nobody asks for the parties, and its verdicts do not pay for them.
    function test_aContractThatJudgesIsToldThePartiesWithItsRight() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        KindId cleaning = organization.numberOf(CLEANING);
        bytes32 role = organization.ORACLE_ROLE();
        vm.startPrank(admin);
        organization.grantRole(role, address(this));
        organization.grantRole(role, address(policy));
        organization.grantRole(organization.AUDITOR_ROLE(), address(policy));
        organization.revokeRole(role, address(policy));
        vm.stopPrank();
        (,, Parties parties) = services.rightOf(oracle, 0, cleaning, serviceId, alice);
        assertTrue(parties == NO_PARTIES);
        (,, parties) = services.rightOf(address(this), 0, cleaning, serviceId, alice);
        assertTrue(parties == packParties(robot1, false));
        vm.prank(admin);
        Possession.register(organization, robot1, "wallet", makeAddr("company"), "robot1");
        (,, parties) = services.rightOf(address(this), 0, cleaning, serviceId, alice);
        assertTrue(parties == packParties(robot1, true));
        bool mayJudge;
        (mayJudge,, parties) = services.rightOf(address(policy), 0, cleaning, serviceId, alice);
        assertFalse(mayJudge);
        assertTrue(parties == packParties(robot1, true));
    }
}
