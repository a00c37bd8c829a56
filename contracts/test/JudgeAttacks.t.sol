// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {AUDITOR_ROLE, ORACLE_ROLE} from "../src/types/Roles.sol";
import {JudgeAttacks} from "./JudgeAttacks.sol";

contract OracleAttacksTest is JudgeAttacks {
    function target() internal view override returns (IJudge) {
        return oracleJudge;
    }

    function say(address sender, Finding memory f) internal override {
        vm.prank(sender);
        oracleJudge.rule(f, REPORT_URI);
    }

    function sayAs(address party, uint256, Finding memory f) internal override {
        bytes32 role = ORACLE_ROLE;
        vm.prank(admin);
        organization.grantRole(role, party);
        say(party, f);
    }

    function _sender() internal view override returns (address) {
        return oracle;
    }
}

contract AuditorAttacksTest is JudgeAttacks {
    function target() internal view override returns (IJudge) {
        return auditorJudge;
    }

    function say(address sender, Finding memory f) internal override {
        vm.prank(sender);
        auditorJudge.rule(f, REPORT_URI);
    }

    function sayAs(address party, uint256, Finding memory f) internal override {
        bytes32 role = AUDITOR_ROLE;
        vm.prank(admin);
        organization.grantRole(role, party);
        say(party, f);
    }

    function _sender() internal view override returns (address) {
        return auditor;
    }
}

contract CommitteeAttacksTest is JudgeAttacks {
    function target() internal view override returns (IJudge) {
        return committee;
    }

    function say(address sender, Finding memory f) internal override {
        _post(sender, f, signatures(f, 3));
    }

    function sayAs(address, uint256 secret, Finding memory f) internal override {
        _post(stranger, f, abi.encodePacked(signatures(f, 2), sign(secret, f)));
    }

    function _post(address sender, Finding memory f, bytes memory votes) private {
        vm.prank(sender);
        committee.postVotes(f, REPORT_URI, votes);
    }
}

contract DisputeAttacksTest is JudgeAttacks {
    function target() internal view override returns (IJudge) {
        return disputes;
    }

    function say(address sender, Finding memory f) internal override {
        _post(sender, f, signatures(f, 3));
    }

    function sayAs(address, uint256 secret, Finding memory f) internal override {
        _post(stranger, f, abi.encodePacked(signatures(f, 2), sign(secret, f)));
    }

    function _post(address sender, Finding memory f, bytes memory votes) private {
        vm.prank(sender);
        disputes.postVotes(f, REPORT_URI, votes);
    }
}
