// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Finding, IJudge} from "../interfaces/IJudge.sol";
import {IOrganization, MAX_CASE, MIN_WINDOW} from "../interfaces/IOrganization.sol";
import {Judged, Task} from "../interfaces/ITaskManager.sol";
import {Judge} from "./Judge.sol";

/// @title One account decides, of those that have a role in the organization.
/// @notice The oracle's judge: whoever has ORACLE_ROLE, and auditors behind it. The auditors' judge: whoever has AUDITOR_ROLE,
/// and nobody behind it. Auditors may judge a kind alone, or decide what others pass on.
contract RoleJudge is Judge {
    /// @notice The role that rules.
    bytes32 public immutable role;

    error NotInRole(address account, bytes32 role);

    constructor(IOrganization organization_, bytes32 role_, address next_) Judge(organization_, next_) {
        role = role_;
    }

    /// @notice Rule now, for good.
    /// @param finding what the caller found
    /// @param reportUri where its report lies
    function rule(Finding calldata finding, string calldata reportUri) external {
        _requireRole();
        Judged memory a = _find(finding, reportUri, 0);
        _requireMayJudge(finding, a, _caller());
        _remember(finding, uint160(msg.sender));
    }

    /// @notice Rule for a judge that passed the case on.
    /// @param judge who did
    /// @param finding what the caller found
    /// @param reportUri where its report lies
    function ruleFor(IJudge judge, Finding calldata finding, string calldata reportUri) external {
        _requireRole();
        Task memory a = _case(finding.taskId);
        _requireNoParty(finding.taskId, _services.providerOf(a.serviceId), a.creator, _caller());
        if (judge.hasPassedOn(finding.taskId, msg.sender)) revert JudgeIsAuditor(finding.taskId, msg.sender);
        judge.ruleForNext(finding, reportUri);
    }

    /// @inheritdoc IJudge
    function termsFor(bytes32) external pure returns (bytes4, uint32, uint32) {
        return (IJudge.termsFor.selector, MIN_WINDOW, MAX_CASE);
    }

    /// @inheritdoc Judge
    function _isAmong(uint248 by, address account) internal view override returns (bool) {
        return _providers.areRelated(account, address(uint160(by)));
    }

    function _requireRole() private view {
        if (!_hasRole(role, msg.sender)) revert NotInRole(msg.sender, role);
    }

    function _caller() private view returns (address[] memory caller) {
        caller = new address[](1);
        caller[0] = msg.sender;
    }
}
