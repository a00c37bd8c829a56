// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {Finding, IJudge} from "../interfaces/IJudge.sol";
import {IOrganization, JUDGE_GAS} from "../interfaces/IOrganization.sol";
import {IProviders} from "../interfaces/IProviders.sol";
import {IServiceManager} from "../interfaces/IServiceManager.sol";
import {ITaskManager, Judged, Ruling, Task, TaskState} from "../interfaces/ITaskManager.sol";
import {Texts} from "../libraries/Texts.sol";
import {ADMINISTRATOR_ROLE} from "../types/Roles.sol";
import {TaskId} from "../types/TaskId.sol";

/// @notice All judges have this in common: whom they judge for, who is a party, how they report, and to whom they pass on
/// what they cannot decide.
abstract contract Judge is IJudge {
    /// @dev The attempt at a task that was passed on last.
    /// @param by who could not decide: see _hasPassedOn
    struct Passed {
        uint8 attempt;
        uint248 by;
    }

    /// @notice Whose kinds it judges.
    IOrganization public immutable organization;
    /// @inheritdoc IJudge
    ITaskManager public immutable tasks;
    /// @inheritdoc IJudge
    address public immutable next;
    IServiceManager internal immutable _services;
    IProviders internal immutable _providers;

    mapping(TaskId taskId => Passed) private _passed;

    modifier onlyAdministrator() {
        _requireAdministrator();
        _;
    }

    constructor(IOrganization organization_, address next_) {
        organization = organization_;
        tasks = organization_.tasks();
        _services = organization_.services();
        _providers = _services.providers();
        next = next_;
    }

    /// @inheritdoc IJudge
    function ruleForNext(Finding calldata finding, string calldata reportUri) external {
        if (msg.sender != next) revert NotNext(msg.sender, next);
        if (_passed[finding.taskId].attempt != finding.attempt) {
            revert NotPassedOn(finding.taskId, finding.attempt);
        }
        if (finding.ruling == Ruling.None) revert MustRule(finding.taskId);
        _find(finding, reportUri, 0);
    }

    /// @inheritdoc IJudge
    function hasPassedOn(TaskId taskId, address account) external view returns (bool) {
        Passed storage passed = _passed[taskId];
        return passed.attempt != 0 && _isAmong(passed.by, account);
    }

    /// @dev Rule, or pass on what cannot be decided, and decide it no more. The ruling goes first, and answers with what the
    /// caller has to fit: nothing of it happens if it does not.
    /// @param until as for ITaskManager.rule
    /// @return a the attempt as it was
    function _find(Finding calldata f, string calldata reportUri, uint256 until)
        internal
        returns (Judged memory a)
    {
        Texts.requireText(reportUri);
        Texts.requireText(f.reason);
        emit Reported(f.taskId, reportUri, f.reason);
        Ruling ruling = f.ruling;
        if (ruling == Ruling.None) {
            if (next == address(0)) revert MustRule(f.taskId);
            emit PassedOn(f.taskId, f.attempt, next);
            (ruling, until) = (Ruling.Void, _case(f.taskId).caseEnd);
        }
        a = tasks.rule(
            f.taskId, f.attempt, f.proofHash, ruling, f.fault, f.amount, uint40(until), f.reportHash
        );
        // Only what is Ruled was passed on: most rulings do not look.
        if (msg.sender != next && a.ruled && _passed[f.taskId].attempt == f.attempt) {
            revert PassedOnBefore(f.taskId, f.attempt);
        }
    }

    /// @dev Remember who could not decide, if nobody could.
    /// @param by as _isAmong reads it
    function _remember(Finding calldata f, uint248 by) internal {
        if (f.ruling == Ruling.None) _passed[f.taskId] = Passed(f.attempt, by);
    }

    /// @dev The task, whose proof waits for a ruling or has one that stands.
    function _case(TaskId taskId) internal view returns (Task memory t) {
        t = tasks.task(taskId);
        if (t.caseEnd == 0) revert ITaskManager.WrongState(taskId, t.state, TaskState.Submitted);
    }

    /// @dev Whether `account` is among those that `by` stands for, or has the same owner as one of them.
    function _isAmong(uint248 by, address account) internal view virtual returns (bool);

    function _requireAdministrator() internal view {
        if (!_hasRole(ADMINISTRATOR_ROLE, msg.sender)) revert NotAdministrator(msg.sender);
    }

    function _hasRole(bytes32 role, address account) internal view returns (bool) {
        return IAccessControl(address(organization)).hasRole(role, account);
    }

    /// @dev None of those who have ruled is a party, or has passed on what it decides.
    /// @param accounts who judged, by all keys and owners
    function _requireMayJudge(Finding calldata f, Judged memory a, address[] memory accounts) internal view {
        _requireNoParty(f.taskId, a.provider, a.creator, accounts);
        // Only what is Ruled was passed on: most rulings do not ask.
        if (!a.ruled) return;
        IJudge judge = organization.judgeNumbered(a.kindId);
        if (address(judge) == address(this)) return;
        for (uint256 i = 0; i < accounts.length; ++i) {
            _requireNotPassedOn(judge, f, accounts[i]);
        }
    }

    /// @dev A party judges nothing, nor does whoever owns one or has the same owner.
    /// @param accounts who judges
    function _requireNoParty(TaskId taskId, address provider, address creator, address[] memory accounts)
        internal
        view
    {
        address party = _providers.partyAmong(accounts, provider, creator);
        if (party != address(0)) revert JudgeIsParty(taskId, party);
    }

    /// @dev Auditors rule here on what a removed judge said. Who passed the case on as that judge decides nothing of it. The
    /// judge may answer anything by now, and holds up nobody who gives it its gas.
    function _requireNotPassedOn(IJudge judge, Finding calldata f, address account) private view {
        bytes memory question = abi.encodeCall(IJudge.hasPassedOn, (f.taskId, account));
        (bool said, bytes memory answer) = address(judge).staticcall{gas: JUDGE_GAS}(question);
        // It had 63 of 64 parts of what was left: less than JUDGE_GAS, if the rest is as little as this.
        if (!said && gasleft() < JUDGE_GAS / 63) revert TooLittleGas(JUDGE_GAS);
        if (said && answer.length == 32 && abi.decode(answer, (uint256)) == 1) {
            revert PassedOnBefore(f.taskId, f.attempt);
        }
    }
}
